"""Recordings in Python: what `info`, `verify`, `recover` and `calibrate` do, with answers of the one kind."""

from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

from estimation.answers.answer import Answer, Rows

if TYPE_CHECKING:
    from groundstation.flight import Flight


def info(file: str | Path) -> "RecordAnswer":
    """What is in a raw recording, the directory of its segments, a flight, or a .tlog."""
    from sideslip.verbs.info import content_of, lines_of

    file = Path(file)
    content = content_of(file)
    return RecordAnswer(content, tuple(lines_of(file, content)))


def verify(recording: str | Path) -> "RecordAnswer":
    """Every byte and every scan of a recording; `passed` is False where something is wrong."""
    from daq.commands import verify_lines
    from daq.contract.recordings.accounting import verify as checked

    verification = checked(recording)
    return RecordAnswer(verification.to_dict(), tuple(verify_lines(Path(recording), verification)), verification.ok)


def recover(recording: str | Path, out: str | Path) -> "RecordAnswer":
    """Save everything undamaged in a recording to a new and sound one; `passed` is False where the original is not sound."""
    from daq.contract.recordings.recovery import recover as salvage

    salvaged = salvage(recording, out)
    content = salvaged.to_dict()
    return RecordAnswer(content, (content["text"],), salvaged.verification.ok)


def calibrate(
    raw: str | Path,
    output: str | Path | None = None,
    *,
    calibration: str | Path | None = None,
    align: bool | None = None,
    salvage: bool = False,
) -> "Calibrated":
    """The counts of a raw recording, or of the directory of its segments, as a flight in SI units.

    output: the flight to write. calibration: directory of calibration files, or `cdfp`, instead of the embedded set. align:
    bring all sensors to one time base, by default where scans have neighbours. salvage: use what is intact of a damaged one.
    """
    from groundstation.calibration.recording import calibrate_recording
    from groundstation.flight import write_flight

    calibration_folder = None if calibration is None else Path(calibration)
    flight = calibrate_recording(Path(raw), calibration_folder, align=align, salvage=salvage)
    if output is not None:
        write_flight(flight, Path(output))
    return Calibrated(flight, str(output or flight.name))


@dataclass(frozen=True, repr=False)
class RecordAnswer(Answer):
    """What there is to say of a recording. content: as the verb's --json has it; sentences: as it prints them."""

    content: Mapping[str, Any]
    sentences: tuple[str, ...]
    sound: bool = True

    @property
    def passed(self) -> bool:
        """Whether the recording is sound, where that was asked."""
        return self.sound

    def to_json(self) -> dict[str, Any]:
        return dict(self.content)

    def lines(self) -> tuple[str, ...]:
        return self.sentences

    def headline(self) -> str:
        return self.sentences[0]

    def numbers(self) -> dict[str, int]:
        """Samples of each channel; of a check, its counts."""
        if "channels" in self.content:
            return {c["name"]: c["samples"] for c in self.content["channels"]}
        return {n: v for n, v in self.content.items() if isinstance(v, int) and not isinstance(v, bool)}

    def rows(self) -> Rows:
        return ("", "number"), [(n, str(v)) for n, v in self.numbers().items()]

    def plot(self, ax: Any = None) -> Any:
        return _bars(self.numbers(), ax)


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
        return _bars(self.numbers(), ax)

    def writers(self) -> Mapping[str, Callable[[Path], Any]]:
        """The flight as .mcap, .csv or .parquet, what is said of it as .json."""
        from groundstation.flight import write_flight

        flights = dict.fromkeys((".mcap", ".csv", ".parquet"), lambda path: write_flight(self.flight, path))
        return {**super().writers(), **flights}


def _bars(numbers: Mapping[str, int], ax: Any) -> Any:
    from estimation.answers.answer import panels

    (axes,) = panels(ax, 1, (7.0, 0.6 + 0.22 * len(numbers)))
    axes.barh(list(numbers), list(numbers.values()))
    axes.invert_yaxis()
    return axes
