"""What a person sees of a data-compatibility check: the table beside the paper's, and the figure."""

from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path

import numpy as np

from estimation.compatibility.reconstruction import Compatibility, FactorEstimate, ReconstructedFlight
from estimation.models.kinematic import STANDARD_FACTORS
from estimation.report import published
from estimation.report.drawing.figures import save_figure
from estimation.report.names import literal

_SHOWN = {"rad": ("deg", np.degrees(1.0)), "V": ("m/s", 1.0)}
_TITLES = {
    "V": "V [m/s]",
    "alpha": "α [deg]",
    "beta": "β [deg]",
    "phi": "φ [deg]",
    "theta": "θ [deg]",
    "psi": "ψ [deg]",
}


def factor_lines(results: Sequence[tuple[str, Compatibility]]) -> Iterator[str]:
    """One column a flight, as in Table 2 of the paper: estimate (bound corrected for coloured innovations)."""
    names = list(results[0][1].factors)
    width = max(21, *(len(n) + 2 for n, _ in results))
    yield f"{'factor':<10}{'unit':<7}" + "".join(f"{name:>{width}}" for name, _ in results)
    for name in names:
        cells = [_cell(r.factors[name]) for _, r in results]
        yield f"{name:<10}{results[0][1].factors[name].unit:<7}" + "".join(f"{c:>{width}}" for c in cells)
    for name, result in results:
        yield f"{name}: {result.text}; turbulence {result.turbulence:.3f} m/s per root second"
        for factor in result.factors.values():
            if not factor.identifiable:
                yield f"{name}: {factor.name}: {factor.why}"
        for note in result.flights[0].notes if len(result.flights) == 1 else ():
            yield f"{name}: {note}"


def published_lines() -> Iterator[str]:
    """The paper's Table 2, to compare with."""
    flights = published.published_flights()
    yield "published (bounds of output error, without the noise of the inertial sensors)"
    yield f"{'factor':<17}" + "".join(f"{name:>21}" for name in flights)
    for factor in STANDARD_FACTORS:
        said = [published.compatibility_factor(flight, factor) for flight in flights]
        yield f"{factor:<17}" + "".join(f"{_published(s):>21}" for s in said)


def _published(said: tuple[float, float] | None) -> str:
    return "" if said is None else f"{said[0]:+.4f} ({said[1]:.4f})"


def _cell(factor: FactorEstimate) -> str:
    if not np.isfinite(factor.estimate):
        return "not measured"
    if not factor.identifiable:
        return "cannot tell"
    return f"{factor.estimate:+.4f} ({factor.std_coloured:.4f})"


def fit_of(flight: ReconstructedFlight) -> Mapping[str, Mapping[str, float]]:
    """Per output: rms of measured less reconstructed, coefficient of determination, whiteness."""
    table = {}
    for j, name in enumerate(flight.outputs):
        both = np.isfinite(flight.measured[:, j]) & np.isfinite(flight.reconstructed[:, j])
        if not both.any():
            continue
        z, residual = flight.measured[both, j], (flight.measured - flight.reconstructed)[both, j]
        spread = float(np.sum((z - z.mean()) ** 2))
        r2 = 1.0 - float(np.sum(residual**2)) / spread if spread > 0 else 0.0
        rms = float(np.sqrt(np.mean(residual**2)))
        table[name] = {"rms": rms, "r2": r2, "noise": flight.noise[name], "whiteness": flight.whiteness[name]}
    return table


def write_figure(flights: Sequence[ReconstructedFlight], path: Path) -> None:
    """Measured and reconstructed motion, one column a flight (Figure 7 of the paper)."""
    from matplotlib.backends.backend_agg import FigureCanvasAgg
    from matplotlib.figure import Figure

    names = flights[0].outputs
    figure = Figure(figsize=(5.2 * len(flights) + 0.8, 1.55 * len(names) + 0.8), layout="constrained")
    FigureCanvasAgg(figure)
    axes = figure.subplots(len(names), len(flights), squeeze=False, sharex="col")
    for column, flight in enumerate(flights):
        gaps = np.concatenate([[False], np.diff(flight.time) > 1.0])
        for row, name in enumerate(names):
            axis = axes[row][column]
            scale = 1.0 if name == "V" else float(np.degrees(1.0))
            for values, colour, width, label in (
                (flight.measured[:, row], "0.45", 0.7, "measured"),
                (flight.reconstructed[:, row], "#0072B2", 1.2, "reconstructed"),
            ):
                shown = np.where(gaps, np.nan, scale * values)
                axis.plot(flight.time, shown, color=colour, linewidth=width, label=label)
            axis.set_ylabel(_TITLES[name])
            axis.grid(alpha=0.25)
        axes[0][column].set_title(literal(flight.name))
        axes[-1][column].set_xlabel("time [s]")
    axes[0][0].legend(loc="upper right", fontsize="small", ncols=2)
    save_figure(figure, path, dpi=110)
