"""From logs to an answer, for `analyse` and `ss.analyse`. Results of stages are stored; a rerun repeats only changed stages."""

from collections.abc import Callable, Sequence
from pathlib import Path
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from estimation.analysis.outcome import Analysis
    from estimation.analysis.stages import Stages
    from groundstation.flight import Flight

FLIGHT_ENDINGS = (".mcap",)
"""Endings of files that may be flights or recordings, and need no import."""


def analyse(
    logs: str | Path | Sequence[str | Path],
    aircraft: str | Path | None = None,
    mapping: str | Path | None = None,
    holdout: Sequence[str | Path] = (),
    output: str | Path = "analysis",
    progress: Callable[[str, float], None] | None = None,
) -> "Analysis":
    """From logs to a page with the answer: what `sideslip analyse` does.

    Args:
        logs: files of one aircraft, of any format that `import` reads.
        aircraft: a built-in name or a file.
        mapping: a file as for `import --map`.
        holdout: logs kept out of every fit.
        output: the folder to write.
        progress: called with a text on the present work, and the share done.

    Raises:
        UserError: one sentence, for a log that cannot be read.

    Example::

        answer = ss.analyse("flight.bin", aircraft="my.toml", output="answer")
        print(answer.summary())
    """
    from estimation.analysis.run import ImportedFlights, analyse_flights
    from estimation.analysis.stages import Stages, digest
    from estimation.prepare.stretches import unique_names
    from estimation.report.page import software

    logs = [logs] if isinstance(logs, str | Path) else list(logs)
    mapping = None if mapping is None else Path(mapping)
    aircraft = None if aircraft is None else str(aircraft)
    report = progress or (lambda what, share: None)
    stages = Stages(Path(output), software())
    aircraft_file = _content(Path(aircraft)) if aircraft and aircraft.endswith(".toml") else ""
    imported = []
    for number, path in enumerate([*logs, *holdout]):
        report(f"importing {Path(path).name}", 0.14 * number / (len(logs) + len(holdout)))
        imported.append(_imported(number, Path(path), mapping, aircraft, stages))
    flights = unique_names([flight for flight, _, _ in imported])
    keys, repeated = tuple(k for _, k, _ in imported), any(r for _, _, r in imported)
    imported_flights = ImportedFlights(tuple(flights[: len(logs)]), tuple(flights[len(logs) :]), keys, repeated)
    return analyse_flights(imported_flights, aircraft, digest([aircraft, aircraft_file]), stages, report)


def _content(path: Path | None) -> str:
    """The content of a small file, for the key of a stage; `path` itself as text where there is no file (a built-in name)."""
    return path.read_bytes().decode("latin-1") if path is not None and path.is_file() else str(path)


def _imported(
    number: int, path: Path, mapping: Path | None, aircraft: str | None, stages: "Stages"
) -> "tuple[Flight, str, bool]":
    """The flight of a log, the key of its stage, and whether it was imported in this run. The stored flight has the aircraft that
    the log names, so that another aircraft file needs no new import."""
    from dataclasses import replace

    from groundstation.flight import read_flight, write_flight
    from groundstation.importers.records import with_aircraft
    from groundstation.importers.run import check_log, log_digest

    check_log(path)
    target = stages.path(f"import_{number}.mcap")

    def work() -> dict[str, object]:
        flight = _read_or_import(path, mapping)
        target.parent.mkdir(parents=True, exist_ok=True)
        write_flight(flight, target)
        return {"name": flight.name, "path": flight.provenance.path, "sha256": flight.provenance.sha256}

    sha = log_digest(path)
    stage = stages.run(f"import_{number}", [sha, path.name, _content(mapping)], work, target)
    flight = read_flight(target)
    provenance = replace(flight.provenance, path=str(path), sha256=sha)
    flight = replace(flight, name=str(stage.content["name"]), provenance=provenance)
    return (flight if aircraft is None else with_aircraft(flight, aircraft)), stage.key, stage.repeated


def _read_or_import(path: Path, mapping: Path | None) -> "Flight":
    """The flight of a file: a flight file, a calibrated raw recording, or an imported foreign log."""
    from groundstation.importers.about import is_foreign_log
    from groundstation.importers.run import import_data

    if path.suffix.lower() in FLIGHT_ENDINGS and mapping is None and not is_foreign_log(path):
        from groundstation.calibration.recording import open_flight

        return open_flight(path)
    return import_data(path, mapping)
