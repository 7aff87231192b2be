"""The command line: a table of verbs, whose modules are imported when they are called.

Exit status: 0 done; 1 done, but the answer is a failed check; 2 unusable input, with one line on standard error; 130 interrupted,
after files are closed.
"""

import contextlib
import importlib
import io
import os
import sys
import traceback
from dataclasses import dataclass
from difflib import get_close_matches
from importlib.metadata import EntryPoint, PackageNotFoundError, entry_points, version
from pathlib import Path
from typing import TYPE_CHECKING, TextIO, cast

import click

from daq.utilities.bytecode import REMEDY
from daq.utilities.durable import DISK_ERRNOS
from daq.utilities.errors import UserError
from daq.utilities.packages import missing
from daq.utilities.plain_words import VisibleStream, one_line
from daq.utilities.standard_streams import SafeStream
from sideslip.first_hour import GREETING, next_line, quiet_first
from sideslip.services import SERVICES
from sideslip.surroundings import refusal

if TYPE_CHECKING:
    from daq.utilities.interrupts import Interrupts


@dataclass(frozen=True, slots=True)
class Verb:
    """Module and attribute of a verb's command, and its line in `sideslip --help`."""

    module: str
    attribute: str
    summary: str


VERBS: dict[str, Verb] = {
    "demo": Verb("sideslip.verbs.demo", "demo", "The whole chain in one go, on a simulated aircraft."),
    "fly": Verb(
        "sideslip.verbs.fly", "fly", "One simulated flight through the real logger, radio link and ground station."
    ),
    "record": Verb("daq.commands", "record", "The onboard logger, on hardware."),
    "preflight": Verb("daq.commands", "preflight", "The logger's go/no-go table."),
    "info": Verb("sideslip.verbs.info", "info", "What is in a recording, flight or telemetry log."),
    "verify": Verb("daq.commands", "verify", "Integrity and scan accounting of a recording."),
    "recover": Verb("daq.commands", "recover", "Salvage a damaged recording."),
    "ground": Verb("groundstation.cli.live", "ground", "Receive, decode, calibrate, view live, record, hand over."),
    "view": Verb("groundstation.cli.view", "view", "Any recording or flight in rerun."),
    "calibrate": Verb("groundstation.cli.data", "calibrate", "Counts to SI: a raw recording to a flight."),
    "bench": Verb("groundstation.cli.data", "bench", "Fit calibration curves from bench recordings."),
    "import": Verb(
        "groundstation.cli.import_log", "import_", "CSV, Parquet, MATLAB, ULog, dataflash or MAVLink log to a flight."
    ),
    "analyse": Verb("sideslip.verbs.analyse", "analyse", "From logs to an answer in one go: one page, one verdict."),
    "export": Verb("sideslip.verbs.export", "export", "Flights, recordings and models for other programs."),
    "check": Verb("sideslip.verbs.check", "check", "Data compatibility and data quality."),
    "reconstruct": Verb("sideslip.verbs.reconstruct", "reconstruct", "Air data and wind of an aircraft without vanes."),
    "estimate": Verb("sideslip.verbs.estimate", "estimate", "Aerodynamic parameters with bounds."),
    "match": Verb("sideslip.verbs.match", "match", "Proof of match on flights not used for the estimate."),
    "performance": Verb(
        "sideslip.verbs.performance", "performance", "Drag polar, glide, sink and power required, with bounds."
    ),
    "frequency": Verb("sideslip.verbs.frequency", "frequency", "Frequency responses with error, fits and figures."),
    "design": Verb("sideslip.verbs.design", "design", "Inputs designed from what is known, under limits."),
    "aircraft": Verb("sideslip.verbs.aircraft", "aircraft", "Your aircraft in one file, and what it is good for."),
    "campaign": Verb("sideslip.verbs.campaign", "campaign", "Hundreds of flights, resumable, into tables to query."),
    "watch": Verb("sideslip.verbs.watch", "watch", "When a model stopped describing the aircraft in flight."),
    "gap": Verb("sideslip.verbs.gap", "gap", "Find, name and close the gap between model and flight."),
    "doctor": Verb("sideslip.verbs.doctor", "doctor", "What is installed here, and what is missing for what."),
    "help": Verb("sideslip.verbs.doctor", "help_", "What a verb does, with its options and an example."),
    "completion": Verb("sideslip.verbs.doctor", "completion", "What makes a shell complete verbs and options."),
}


SUGGESTED = 3  # verbs suggested for a mistyped one
ALIKE = 0.6  # least similarity, difflib's default: one letter wrong, missing or swapped in a word of five
BEGINNING = 2  # letters from which the beginning of a verb suggests it

QUIET = "sideslip.quiet"
"""Key of click's context: whether progress and the next step are not printed."""
INTERRUPTED = "sideslip: interrupted; files are closed"
TRACEBACK = "SIDESLIP_TRACEBACK"
"""Environment variable with which an error of this program ends in Python's traceback: for developers, and in all tests."""


class VerbTable(click.Group):
    """A click group whose commands are imported on use, so that `--help` and light verbs stay light."""

    def list_commands(self, ctx: click.Context) -> list[str]:
        """All verbs, in the order of the table; then those of installed packages."""
        return [*VERBS, *(entry.name for entry in _package_verbs())]

    def get_command(self, ctx: click.Context, cmd_name: str) -> click.Command | None:
        verb = VERBS.get(cmd_name)
        if verb is None:
            return _package_verb(cmd_name)
        try:
            command: click.Command = getattr(importlib.import_module(verb.module), verb.attribute)
        except ModuleNotFoundError as error:
            raise missing(error, f"sideslip {cmd_name}") from error
        return command

    def resolve_command(
        self, ctx: click.Context, args: list[str]
    ) -> tuple[str | None, click.Command | None, list[str]]:
        """The verb of the first word; the usage error for a mistyped one suggests similar verbs."""
        word = args[0] if args else ""
        if word and not word.startswith("-") and self.get_command(ctx, word) is None and not ctx.resilient_parsing:
            ctx.fail(f"No such verb {word!r}{_suggestion(word, self.list_commands(ctx), args[1:])}")
        return super().resolve_command(ctx, args)

    def format_commands(self, ctx: click.Context, formatter: click.HelpFormatter) -> None:
        """The list of verbs from the table, without importing them."""
        with formatter.section("Commands"):
            rows = [(name, verb.summary) for name, verb in VERBS.items()]
            formatter.write_dl([*rows, *((entry.name, f"From {entry.module}.") for entry in _package_verbs())])


def _suggestion(word: str, verbs: list[str], rest: list[str]) -> str:
    """End of a sentence that suggests what an unknown verb may mean: similar verbs, or `info` for a file; else empty."""
    if Path(word).suffix and Path(word).exists():
        return f"; it is a file: did you mean 'sideslip {' '.join(['info', word, *rest])}'?"
    small = word.lower()
    similar_verbs = get_close_matches(small, verbs, n=SUGGESTED, cutoff=ALIKE)
    similar_verbs += [v for v in verbs if len(small) >= BEGINNING and v.startswith(small) and v not in similar_verbs]
    quoted_verbs = [f"'sideslip {v}'" for v in similar_verbs[:SUGGESTED]]
    return f"; did you mean {' or '.join(quoted_verbs)}?" if quoted_verbs else ""


def _package_verbs() -> tuple[EntryPoint, ...]:
    """Verbs that installed packages bring, by the entry point group `sideslip.verbs`: a click command each."""
    return tuple(p for p in entry_points(group="sideslip.verbs") if p.name not in VERBS)


def _package_verb(name: str) -> click.Command | None:
    """The command of an installed package; None where no package has it. UserError where it cannot be imported."""
    for entry in _package_verbs():
        if entry.name == name:
            try:
                command: click.Command = entry.load()
            except (ImportError, AttributeError) as error:
                raise UserError(
                    f"entry point sideslip.verbs {name} = {entry.value}: no command there ({error}); correct the package"
                ) from error
            return command
    return None


def software_version() -> str:
    """Version of the installed package, or 'unknown' when run from a bare tree."""
    try:
        return version("sideslip")
    except PackageNotFoundError:
        return "unknown"


@click.command(
    cls=VerbTable,
    context_settings={"help_option_names": ["-h", "--help"], "obj": SERVICES},
    invoke_without_command=True,
)
@click.option("--quiet", is_flag=True, help="No progress, and no word on what to do next.")
@click.pass_context
@click.version_option(software_version(), prog_name="sideslip")
def cli(context: click.Context, quiet: bool) -> None:
    """Airborne data acquisition and aircraft identification."""
    context.meta[QUIET] = quiet
    if context.invoked_subcommand is None:
        click.echo(GREETING.rstrip())


def run(argv: list[str] | None, interrupts: "Interrupts | None") -> None:
    """Run a command line and end the process with its exit status; errors become one line. interrupts: handles Ctrl-C."""
    for stream in (sys.stdout, sys.stderr):
        if isinstance(stream, io.TextIOWrapper):  # names of files need not be valid text
            stream.reconfigure(errors="backslashreplace")
    if interrupts is not None:
        interrupts.raise_in_work()
    output_stream, err = SafeStream(sys.stdout), SafeStream(sys.stderr)
    visible_out, visible_err = (
        cast("TextIO", VisibleStream(cast("TextIO", stream))) for stream in (output_stream, err)
    )
    with contextlib.redirect_stdout(visible_out), contextlib.redirect_stderr(visible_err):
        status = _with_streams(_status(argv, interrupts), output_stream, err)
    if interrupts is not None:
        interrupts.leave_at_once()  # all files are closed, and the interpreter ends
        if interrupts.seen and not status:  # Ctrl-C came during the last import, and did not stop the work
            click.echo(interrupts.words, err=True)
            status = interrupts.status
    sys.exit(status)


def _with_streams(status: int, out: SafeStream, err: SafeStream) -> int:
    """The exit status after all output is flushed: a closed pipe leaves it, a full disk makes it 2."""
    out.flush()
    if out.trouble is not None and out.trouble.errno in DISK_ERRNOS:
        status = _error_line(
            f"standard output: {out.trouble.strerror}; everything else is done, only its words are lost"
        )
    err.flush()
    for stream in (out, err):
        stream.give_up()
    return status


def _status(argv: list[str] | None, interrupts: "Interrupts | None" = None) -> int:
    """Run a command line; its exit status. The one place where exceptions become lines and a status."""
    words, quiet = quiet_first(sys.argv[1:] if argv is None else argv)
    try:
        status = cli.main(args=["--quiet", *words] if quiet else words, prog_name="sideslip", standalone_mode=False)
    except click.ClickException as error:
        context = error.ctx if isinstance(error, click.UsageError) else None
        text = error.format_message().rstrip(".")
        hint = f"{' See' if text.endswith('?') else '; see'} '{context.command_path} --help'" if context else ""
        return _error_line(text + hint)
    except UserError as error:
        return _error_line(str(error))
    except ModuleNotFoundError as error:
        return _error_line(str(missing(error, f"sideslip {(words or [''])[0]}".rstrip())))
    except (KeyboardInterrupt, click.Abort) as error:
        if isinstance(error.__cause__, EOFError):  # a damaged .pyc file: click takes it for Ctrl-D at a prompt
            return _error_line(f"{REMEDY} under {Path(__file__).parents[1]} and its environment")
        click.echo(INTERRUPTED if interrupts is None else interrupts.words, err=True)
        return 130 if interrupts is None else interrupts.status
    except BrokenPipeError as error:  # with a name: an output file that is a pipe, whose reader has ended
        return 0 if error.filename is not None else _unforeseen(error)
    except Exception as error:  # noqa: BLE001  the edge of the process: any error becomes one sentence, and never the status of a check
        sentence = refusal(error)
        return _unforeseen(error) if sentence is None else _error_line(sentence)
    status = status if isinstance(status, int) else 0
    if not quiet and status in (0, 1) and (line := next_line(words, failed=status == 1)):
        click.echo(f"next: {line}", err=True)
    return status


def _unforeseen(error: Exception) -> int:
    """One sentence on an error of this program; with TRACEBACK in the environment it is raised."""
    if os.environ.get(TRACEBACK):
        raise error
    last_frame = traceback.extract_tb(error.__traceback__)[-1:]
    place = f" at {Path(last_frame[0].filename).name}:{last_frame[0].lineno}" if last_frame else ""
    return _error_line(
        f"a mistake in this program, please report it: {type(error).__name__}{place}: {str(error) or 'no words'}"
        f"; {TRACEBACK}=1 in the environment shows where it comes from"
    )


def _error_line(sentence: str) -> int:
    """Print one line on standard error; the exit status 2."""
    click.echo(f"sideslip: {one_line(sentence)}", err=True)
    return 2
