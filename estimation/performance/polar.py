"""The drag polar CD = CD_0 + CD_k CL^2 of several flights; from it glide, sink and power required, each with bounds.

An offset of the angle of attack, of vane or accelerometer, turns lift into drag: CD + offset CL. It is fitted beside the polar,
with the usual error of aligned instruments as prior. Bounds are corrected for coloured residuals.
"""

import math
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from daq.utilities.constants import GRAVITY, NORMAL_95
from estimation.aircraft import Aircraft
from estimation.engine.kernel import Array
from estimation.errors import DataError
from estimation.estimators.coloured import ResidualSegment, score_covariance
from estimation.performance.samples import PolarSamples, Usable, all_stretches
from estimation.report.drawing.figures import MEASURED, Picture, picture, save_figure, styled

if TYPE_CHECKING:
    from matplotlib.figure import Figure

OFFSET = math.radians(0.3)  # 1 sigma of the error of aligned vane and accelerometer together
SURE = 2.0  # bounds from zero above which a coefficient is known
ROUNDS = 3  # of the scale of the residuals, on which the weight of the prior depends
POINTS = 13  # of the curve
EDGES = (0.02, 0.98)  # quantiles of the lift flown between which the curve is given
LEAST_LIFT = (1e-3, 2e-3)  # CL at the ends of the curve, at least: its speed is finite


@dataclass(frozen=True)
class Bounded:
    """An estimate with its standard deviation."""

    estimate: float
    std: float

    @property
    def ends(self) -> tuple[float, float]:
        """The 95 % interval; on a logarithmic scale where the number is above zero by more than SURE of its bounds."""
        if self.estimate > SURE * self.std:
            factor = math.exp(NORMAL_95 * self.std / self.estimate)
            return self.estimate / factor, self.estimate * factor
        return self.estimate - NORMAL_95 * self.std, self.estimate + NORMAL_95 * self.std


@dataclass(frozen=True)
class Polar:
    """values (3,), covariance (3, 3): of CD_0, CD_k and the offset of the angle of attack [rad]. lift: range of CL flown; rms: of
    the residuals of CD; density: mean of the flights [kg/m3]."""

    values: Array
    covariance: Array
    lift: tuple[float, float]
    rms: float
    density: float

    def __getitem__(self, name: str) -> Bounded:
        i = ("CD_0", "CD_k", "alpha_offset").index(name)
        return Bounded(float(self.values[i]), math.sqrt(float(self.covariance[i, i])))

    @property
    def known(self) -> bool:
        """Whether both coefficients are above zero beyond their bounds."""
        return all(self[n].estimate > SURE * self[n].std for n in ("CD_0", "CD_k"))


@dataclass(frozen=True)
class PolarPoint:
    """Level flight or a shallow glide at one speed. V [m/s], drag [N], sink with the motor off [m/s], power required [W]."""

    V: float
    CL: float
    drag: Bounded
    sink: Bounded
    power: Bounded


def fitted(stretches: Sequence[PolarSamples]) -> Polar:
    """The polar of all stretches by weighted least squares. Raises DataError where there are none."""
    if not stretches:
        raise DataError(
            "no stretch of any flight has lift and drag with thrust known; fly glides with the throttle off"
        )
    rows = [np.column_stack([np.ones(s.V.size), s.smooth_CL**2, s.smooth_CL]) / s.scatter[:, None] for s in stretches]
    scaled_drag = [s.CD / s.scatter for s in stretches]
    # scale: residuals over the noise expected of them, which weights the data against the prior
    values, scale = np.zeros(3), 1.0
    for _ in range(ROUNDS):
        inverse = _inverse(rows, scale)
        values = inverse @ np.sum([J.T @ y for J, y in zip(rows, scaled_drag, strict=True)], axis=0) / scale**2
        residuals = [y - J @ values for J, y in zip(rows, scaled_drag, strict=True)]
        scale = max(math.sqrt(float(np.mean(np.concatenate(residuals) ** 2))), 1e-9)
    inverse = _inverse(rows, scale)
    pieces = [
        ResidualSegment((e / scale)[:, None], J / scale, np.zeros((e.size, 0)), np.ones((e.size, 1), bool))
        for e, J in zip(residuals, rows, strict=True)
    ]
    products = score_covariance(pieces, inverse, [np.zeros((0, 0))] * len(pieces))
    products[2, 2] += 1.0 / OFFSET**2
    covariance = inverse @ products @ inverse
    lift = np.concatenate([s.smooth_CL for s in stretches])
    drag_residuals = np.concatenate([e * s.scatter for e, s in zip(residuals, stretches, strict=True)])
    density = float(np.mean(np.concatenate([s.rho for s in stretches])))
    low, high = (float(v) for v in np.quantile(lift, EDGES))
    return Polar(values, covariance, (low, high), float(np.sqrt(np.mean(drag_residuals**2))), density)


def _inverse(rows: Sequence[Array], scale: float) -> Array:
    """(3, 3) inverse of the information, which includes the prior of the offset."""
    information = np.sum([J.T @ J for J in rows], axis=0) / scale**2
    information[2, 2] += 1.0 / OFFSET**2
    return np.asarray(np.linalg.pinv(information, rcond=1e-15))


def _bounded(polar: Polar, estimate: float, power_CD_0: float, power_CD_k: float) -> Bounded:
    """An estimate in proportion to CD_0^power_CD_0 CD_k^power_CD_k, with its bound."""
    slopes = estimate * np.array([power_CD_0 / polar.values[0], power_CD_k / polar.values[1]])
    return Bounded(estimate, math.sqrt(float(slopes @ polar.covariance[:2, :2] @ slopes)))


def best_glide(polar: Polar, aircraft: Aircraft) -> dict[str, Bounded]:
    """Glide ratio, its speed [m/s] and lift coefficient: E = 1/(2 sqrt(CD_0 CD_k)) at CL = sqrt(CD_0/CD_k)."""
    CD_0, CD_k = polar.values[:2]
    CL = math.sqrt(CD_0 / CD_k)
    return {
        "ratio": _bounded(polar, 0.5 / math.sqrt(CD_0 * CD_k), -0.5, -0.5),
        "speed": _bounded(polar, _speed(polar, aircraft, CL), -0.25, 0.25),
        "CL": _bounded(polar, CL, 0.5, -0.5),
    }


def flown(polar: Polar, CL: float) -> bool:
    """Whether the flights reached this lift coefficient: beyond, the parabola is extrapolated and the wing may be stalled."""
    return polar.lift[0] <= CL <= polar.lift[1]


def least_sink(polar: Polar, aircraft: Aircraft) -> dict[str, Bounded]:
    """Least sink with the motor off [m/s], and least power [W], at CL = sqrt(3 CD_0/CD_k), with their speed [m/s] and CL."""
    CD_0, CD_k = polar.values[:2]
    CL = math.sqrt(3.0 * CD_0 / CD_k)
    speed = _speed(polar, aircraft, CL)
    sink = speed * 4.0 * CD_0 / CL
    return {
        "CL": _bounded(polar, CL, 0.5, -0.5),
        "sink": _bounded(polar, sink, 0.25, 0.75),
        "power": _bounded(polar, sink * aircraft.mass * GRAVITY, 0.25, 0.75),
        "speed": _bounded(polar, speed, -0.25, 0.25),
    }


def _speed(polar: Polar, aircraft: Aircraft, CL: float) -> float:
    return math.sqrt(2.0 * aircraft.mass * GRAVITY / (polar.density * aircraft.area * CL))


def curve(polar: Polar, aircraft: Aircraft) -> tuple[PolarPoint, ...]:
    """Drag, sink and power over the speeds whose lift was flown, for lift equal to weight."""
    weight = aircraft.mass * GRAVITY
    low, high = (max(CL, least) for CL, least in zip(polar.lift, LEAST_LIFT, strict=True))
    points = []
    for V in np.linspace(_speed(polar, aircraft, high), _speed(polar, aircraft, low), POINTS):
        area = 0.5 * polar.density * V**2 * aircraft.area
        CL = weight / area
        slopes = area * np.array([1.0, CL**2])  # drag is linear in both coefficients
        drag = Bounded(float(slopes @ polar.values[:2]), math.sqrt(float(slopes @ polar.covariance[:2, :2] @ slopes)))
        sink, power = (Bounded(drag.estimate * f, drag.std * f) for f in (float(V) / weight, float(V)))
        points.append(PolarPoint(float(V), float(CL), drag, sink, power))
    return tuple(points)


SHOWN = 4000  # samples in the figure: more would overlap
COLOUR = "#0072B2"
SIZE = (6.4, 7.6)  # inches
DPI = 150


def draw_performance(flights: Sequence[Usable], polar: Polar, curve: Sequence[PolarPoint], axes: Any) -> None:
    """Lift over drag, sink and power on three axes."""
    stretches = all_stretches(flights)
    CL, CD = (np.concatenate([getattr(s, n) for s in stretches]) for n in ("smooth_CL", "CD"))
    decimation = max(1, CL.size // SHOWN)
    axes[0].plot(CD[::decimation], CL[::decimation], ".", color=MEASURED, markersize=1.5, label="samples")
    lift = np.linspace(*polar.lift, 60)
    drag = polar.values[0] + polar.values[1] * lift**2
    rows = np.column_stack([np.ones(60), lift**2])
    band = NORMAL_95 * np.sqrt(np.einsum("ij,jk,ik->i", rows, polar.covariance[:2, :2], rows))
    axes[0].fill_betweenx(lift, drag - band, drag + band, color=COLOUR, alpha=0.3, linewidth=0)
    axes[0].plot(drag, lift, color=COLOUR, label="polar")
    axes[0].set_xlabel("CD")
    axes[0].set_ylabel("CL")
    axes[0].legend(loc="lower right")
    for ax, name, label in ((axes[1], "sink", "sink, motor off [m/s]"), (axes[2], "power", "power required [W]")):
        _banded(ax, [p.V for p in curve], [getattr(p, name) for p in curve])
        ax.set_xlabel("airspeed [m/s]")
        ax.set_ylabel(label)


def _banded(ax: Any, speed: Sequence[float], values: Sequence[Bounded]) -> None:
    middle, band = np.array([v.estimate for v in values]), NORMAL_95 * np.array([v.std for v in values])
    ax.fill_between(speed, middle - band, middle + band, color=COLOUR, alpha=0.3, linewidth=0)
    ax.plot(speed, middle, color=COLOUR)


def _figure(flights: Sequence[Usable], polar: Polar, curve: Sequence[PolarPoint]) -> "Figure":
    from matplotlib.figure import Figure

    figure = Figure(figsize=SIZE, layout="constrained")
    draw_performance(flights, polar, curve, figure.subplots(3))
    return figure


def performance_picture(flights: Sequence[Usable], polar: Polar, curve: Sequence[PolarPoint]) -> Picture:
    with styled():
        figure = _figure(flights, polar, curve)
    caption = "Samples of lift and drag with the polar; sink with the motor off and power required; bands hold 95 %."
    return picture(figure, "performance", caption, points=SHOWN)


def write_performance(flights: Sequence[Usable], polar: Polar, curve: Sequence[PolarPoint], path: Path) -> None:
    with styled():
        save_figure(_figure(flights, polar, curve), path, DPI)
