"""Measured and estimated (or predicted) histories: as figures, and as flights with both for `sideslip view`."""

from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

from estimation.report.drawing.figures import save_figure
from estimation.report.names import face, literal
from groundstation.flight import Array

if TYPE_CHECKING:
    from estimation.estimators.result import Result
    from estimation.models.base import Model
    from estimation.session.proof_of_match import ProofOfMatch
    from estimation.session.session import EstimationSession
    from groundstation.flight import Flight


def write_histories(session: "EstimationSession", path: Path) -> None:
    """Draw measured and estimated outputs of every flight, one curve for each method; format by the ending of `path`."""
    columns = []
    for f in session.flights:
        results = [r for r in f.results.values() if r.flights]
        if not results:
            continue
        fitted = {r.method: r.flights[0].outputs for r in results}
        columns.append((f.flight.name, results[0].flights[0].time, results[0].flights[0].measured, fitted))
    _draw(next(iter(session.flights[0].results.values())).model, columns, path)


def write_proof(proofs: Sequence["ProofOfMatch"], path: Path) -> None:
    """Draw measured and predicted outputs of every flight; format by the ending of `path`."""
    columns = [(p.name, p.time, p.measured, {"predicted": p.predicted}) for p in proofs]
    _draw(proofs[0].result.model, columns, path)


def write_flights(session: "EstimationSession", folder: Path, most: int | None = None) -> list[Path]:
    """Write each flight (the first `most`) with the outputs of its first method beside the measured ones; returns the files."""
    estimated_flights = [f for f in session.flights if f.results][:most]
    return [write_beside(f.flight, next(iter(f.results.values())), folder) for f in estimated_flights]


def write_beside(flight: "Flight", result: "Result", folder: Path) -> Path:
    """Write folder/<name>.mcap: the flight with a column `<column>_model` for every output of the model; returns the file."""
    from groundstation.flight import write_flight

    model_outputs = result.flights[0].outputs
    columns = {f"{signal.source}_model": model_outputs[:, i] for i, signal in enumerate(result.model.outputs)}
    path = folder / f"{flight.name}.mcap"
    write_flight(flight.with_columns(**columns), path)
    return path


def _draw(model: "Model", columns: Sequence[tuple[str, Array, Array, dict[str, Array]]], path: Path) -> None:
    """Draw flights beside each other. columns: name, time (N,), measured (N, ny), label -> curve (N, ny)."""
    from matplotlib.figure import Figure

    rows = len(model.outputs)
    figure = Figure(figsize=(4.5 * len(columns) + 1.5, 1.7 * rows + 0.8), layout="constrained")
    axes: Any = figure.subplots(rows, len(columns), sharex="col", squeeze=False)
    for j, (name, time, measured, fitted) in enumerate(columns):
        for i, signal in enumerate(model.outputs):
            factor, unit = face(signal.name, signal.unit)
            axis = axes[i][j]
            axis.plot(time, measured[:, i] * factor, ".", color="0.6", markersize=2.5, label="measured")
            for label, outputs in fitted.items():
                axis.plot(time, outputs[:, i] * factor, linewidth=1.1, label=label)
            axis.grid(alpha=0.3)
            if j == 0:
                axis.set_ylabel(literal(f"{signal.name} [{unit}]"))
        axes[0][j].set_title(literal(name), fontsize=10)
        axes[-1][j].set_xlabel("time [s]")
    axes[0][0].legend(fontsize=8)
    save_figure(figure, path, dpi=110)
