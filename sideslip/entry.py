"""Entry point of the command: handles Ctrl-C before the imports, which take the first second."""

from daq.utilities.bytecode import spare_full_disk

spare_full_disk()

from daq.utilities.interrupts import Interrupts, started_as_command  # noqa: E402  importing writes compiled files

INTERRUPTS = Interrupts() if started_as_command("sideslip") else None
if INTERRUPTS is not None:
    INTERRUPTS.leave_at_once()


def main(argv: list[str] | None = None) -> None:
    """Run `sideslip` with these arguments, or those of the process; ends it with the exit status."""
    from daq.utilities.standard_streams import sound_descriptors

    sound_descriptors()
    from sideslip.cli import run

    run(argv, INTERRUPTS)
