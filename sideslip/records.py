"""Recordings in Python: the functions behind `info`, `verify`, `recover`, `calibrate` and `bench`."""

from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

from estimation.answers.answer import Answer, Rows
from estimation.answers.files import FileAnswer, bars

if TYPE_CHECKING:
    from datetime import date

    from groundstation.flight import Flight


def info(file: str | Path) -> "FileAnswer":
    """Content of a recording, a flight, or a log of another program.

    Args:
        file: the file, or the directory of a recording's segments.

    Example::

        print(ss.info("ld1.mcap").summary())
    """
    from sideslip.verbs.info import content_of, lines_of

    file = Path(file)
    content = content_of(file)
    return FileAnswer(content, tuple(lines_of(file, content)))


def verify(recording: str | Path) -> "FileAnswer":
    """Check every byte and every scan of a recording.

    Args:
        recording: the file, or the directory of its segments.

    `passed` is False where it is damaged or incomplete.

    Example::

        assert ss.verify("recordings/cdfp_ld1_raw.mcap").passed
    """
    from daq.commands import verify_lines
    from daq.contract.recordings.accounting import verify as checked

    verification = checked(recording)
    return FileAnswer(verification.to_dict(), tuple(verify_lines(Path(recording), verification)), verification.ok)


def recover(recording: str | Path, out: str | Path) -> "FileAnswer":
    """Save the undamaged part of a recording as a new recording.

    Args:
        recording: the file, or the directory of its segments.
        out: the file to write.

    `passed` is False where the original is damaged.

    Example::

        ss.recover("damaged.mcap", "sound.mcap")
    """
    from daq.contract.recordings.recovery import recover as salvage

    salvaged = salvage(recording, out)
    content = salvaged.to_dict()
    return FileAnswer(content, (content["text"],), salvaged.verification.ok)


def calibrate(
    raw: str | Path,
    output: str | Path | None = None,
    *,
    calibration: str | Path | None = None,
    align: bool | None = None,
    salvage: bool = False,
) -> "Calibrated":
    """The counts of a raw recording as a flight in SI units.

    Args:
        raw: the file, or the directory of its segments.
        output: the flight to write.
        calibration: directory of calibration files, or cdfp, instead of the embedded set.
        align: bring all sensors to one time base; by default where scans have neighbours.
        salvage: use the intact part of a damaged recording.

    Example::

        flight = ss.calibrate("ld1_raw.mcap", "ld1.mcap").flight
    """
    from groundstation.calibration.recording import calibrate_recording
    from groundstation.flight import write_flight

    calibration_folder = None if calibration is None else Path(calibration)
    flight = calibrate_recording(Path(raw), calibration_folder, align=align, salvage=salvage)
    if output is not None:
        write_flight(flight, Path(output))
    return Calibrated(flight, str(output or flight.name))


def bench(
    raw: str | Path,
    plan: str | Path,
    output: str | Path,
    *,
    calibration: str | Path | None = None,
    day: "date | None" = None,
) -> "FileAnswer":
    """Fit calibration files from a bench recording, and write them with the rest of the set.

    Args:
        raw: the recording.
        plan: a TOML file with the references that were set, and when.
        output: the folder to write.
        calibration: directory to refine, or cdfp, in place of the embedded set.
        day: of the bench, where the recording carries none.

    Example::

        ss.bench("bench/onboard", "bench/plan.toml", "calibration")
    """
    from groundstation.cli.data import fit_and_write

    content, sentences = fit_and_write(
        Path(raw), Path(plan), Path(output), None if calibration is None else Path(calibration), day
    )
    return FileAnswer(content, sentences)


@dataclass(frozen=True, repr=False)
class Calibrated(Answer):
    """A flight in SI units. name: of its file where one was written."""

    flight: "Flight"
    name: str

    def to_json(self) -> dict[str, Any]:
        from groundstation.cli.data import written_content

        return written_content(self.flight, self.name)

    def lines(self) -> Iterator[str]:
        from groundstation.cli.data import written_lines

        return written_lines(self.flight, self.name)

    def headline(self) -> str:
        return next(self.lines())

    def numbers(self) -> dict[str, int]:
        import numpy as np

        return {n: int(np.isfinite(v).sum()) for n, v in self.flight.columns.items()}

    def rows(self) -> Rows:
        return ("column", "samples"), [(n, str(v)) for n, v in self.numbers().items()]

    def plot(self, ax: Any = None) -> Any:
        return bars(self.numbers(), ax)

    def writers(self) -> Mapping[str, Callable[[Path], Any]]:
        """Writers of the flight as .mcap, .csv or .parquet, and of its description as .json."""
        from groundstation.flight import write_flight

        flights = dict.fromkeys((".mcap", ".csv", ".parquet"), lambda path: write_flight(self.flight, path))
        return {**super().writers(), **flights}
