"""The published short periods of the T-38 beside what five stretches of roller coasters predict of them.

    python -m tests.studies.t38_points t38.json

t38.json is what `estimate --each-segment --json` made of the record (docs/validation/t38.md). Derivatives of its stretches are
taken as straight lines in Mach number; what they scatter about the lines (fuel, CG, nonlinear terms that the model lacks) is in
the bounds, for a published point was flown on another day at a fuel that nobody states. Speed and density of a point follow from
its Mach number and dynamic pressure in the standard atmosphere.

A point is not predicted above Mach 0.95 (MACH): no stretch flew there, and the aerodynamic centre moves aft by a quarter chord.
"""

import json
import sys
from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.stats import t as student

Array = NDArray[np.float64]
PSF, GAS = 47.880259, 287.05287
AREA, CHORD, MASS, IYY = 15.79, 2.374, 5200.0, 40500.0
MACH = (0.35, 0.95)
INSIDE = 0.95
ROUNDED = 0.005
"""Half the last digit of published frequencies [Hz] and damping ratios."""
NAMES = ("CL_alpha", "Cm_alpha", "Cm_q")
PUBLISHED = (
    (513, 0.72, 0.32, 0.71), (203, 0.38, 0.29, 0.71), (458, 0.90, 0.22, 1.08), (498, 0.86, 0.32, 0.91), (551, 0.64, 0.36, 0.90),
    (334, 0.46, 0.31, 0.70), (170, 0.34, 0.31, 0.50), (551, 0.66, 0.38, 0.90), (334, 0.47, 0.34, 0.70), (170, 0.34, 0.35, 0.50),
    (551, 0.65, 0.33, 0.90), (334, 0.49, 0.31, 0.70), (125, 0.37, 0.30, 0.35), (125, 0.37, 0.23, 0.35), (198, 0.36, 0.27, 0.60),
    (141, 0.38, 0.26, 0.81), (807, 0.83, 0.35, 0.89), (182, 0.42, 0.18, 0.92), (445, 0.67, 0.30, 0.90), (242, 0.56, 0.13, 1.06),
    (653, 0.83, 0.17, 1.09),
)  # fmt: skip
"""Dynamic pressure [psf], frequency [Hz], damping ratio, Mach number: josh0tt/PIGPSEE, empirical points."""
STRETCHES = (0.70, 0.88, 0.69, 0.49, 0.68)
"""Mean Mach numbers of the record's stretches."""


@dataclass(frozen=True)
class Line:
    """A derivative as a line in Mach number. coefficients: (2,) value at Mach 0.7 and slope, with covariance; between: variance
    of a stretch about it."""

    coefficients: Array
    covariance: Array
    between: float

    @classmethod
    def through(cls, mach: Array, values: Array, stds: Array) -> "Line":
        """Least squares, weighted by the bounds and the scatter beyond them."""
        design = np.column_stack([np.ones_like(mach), mach - 0.7])
        between = 0.0
        for _ in range(50):  # the scatter that makes the weighted squares as large as their freedom
            weight = 1.0 / (stds**2 + between)
            covariance = np.linalg.inv(design.T @ (weight[:, None] * design))
            coefficients = covariance @ (design.T @ (weight * values))
            squares = float(weight @ (values - design @ coefficients) ** 2)
            between = max(0.0, between + (squares - (len(mach) - 2)) / float(weight.sum()))
        return cls(coefficients, covariance, between)

    def draw(self, mach: float, rng: np.random.Generator, count: int) -> Array:
        """(count,) values that another flight may have at a Mach number."""
        row = np.array([1.0, mach - 0.7])
        std = np.sqrt(row @ self.covariance @ row + self.between)
        return np.asarray(row @ self.coefficients + std * student.rvs(3, size=count, random_state=rng))


def atmosphere(pressure: float) -> float:
    """Temperature [K] of the standard atmosphere by its pressure [Pa]."""
    return max(288.15 * (pressure / 101325.0) ** 0.190263, 216.65)


def short_period(dynamic_pressure: float, mach: float, d: Mapping[str, Array]) -> tuple[Array, Array]:
    """Frequency [Hz] and damping ratio by derivatives; dynamic_pressure [Pa]."""
    pressure = dynamic_pressure / (0.7 * mach**2)
    speed = mach * np.sqrt(1.4 * GAS * atmosphere(pressure))
    lift = dynamic_pressure * AREA * d["CL_alpha"] / (MASS * speed)
    moment = dynamic_pressure * AREA * CHORD / IYY
    damping = -moment * d["Cm_q"] * CHORD / (2.0 * speed)
    omega = np.sqrt(np.maximum(-moment * d["Cm_alpha"] + lift * damping, 1e-6))
    return omega / (2.0 * np.pi), (lift + damping) / (2.0 * omega)


def lines_of(answer: Mapping[str, Any]) -> dict[str, Line]:
    """Lines through the stretches of an estimate's JSON."""
    stretches = [f["methods"]["ml"]["parameters"] for f in answer["flights"]]
    mach = np.array(STRETCHES[: len(stretches)])
    return {
        n: Line.through(mach, *(np.array([s[n][k] for s in stretches]) for k in ("estimate", "std_coloured")))
        for n in NAMES
    }


def table(answer: Mapping[str, Any]) -> Iterator[str]:
    """A row for each published point, and how many are inside."""
    lines, rng = lines_of(answer), np.random.default_rng(38)
    head = "| Mach | dynamic pressure [psf] | frequency [Hz] | ours, 95 % | damping ratio | ours, 95 % | |"
    yield f"{head}\n|---|---|---|---|---|---|---|"
    inside = {"frequency": 0, "damping ratio": 0}
    predicted = 0
    for pressure, frequency, damping, mach in PUBLISHED:
        point = f"| {mach:.2f} | {pressure} | {frequency:.2f}"
        if not MACH[0] <= mach <= MACH[1]:
            yield f"{point} | - | {damping:.2f} | - | above the Mach numbers flown |"
            continue
        predicted += 1
        drawn = {n: line.draw(mach, rng, 20_000) for n, line in lines.items()}
        columns, out = [], []
        published = {"frequency": frequency, "damping ratio": damping}
        for (word, value), ours in zip(published.items(), short_period(pressure * PSF, mach, drawn), strict=True):
            low, high = np.quantile(ours, [(1 - INSIDE) / 2, (1 + INSIDE) / 2])
            within = low - ROUNDED <= value <= high + ROUNDED
            inside[word] += within
            columns.append(f"{np.median(ours):.2f} ({low:.2f} to {high:.2f})")
            out += [] if within else [f"{word} is {'less' if value < low else 'more'}"]
        yield f"{point} | {columns[0]} | {damping:.2f} | {columns[1]} | {', '.join(out)} |"
    counts = ", ".join(f"{word} {count}" for word, count in inside.items())
    yield f"\nInside, of {predicted} points predicted and {len(PUBLISHED)} published: {counts}."


if __name__ == "__main__":
    print("\n".join(table(json.loads(Path(sys.argv[1]).read_text(encoding="utf-8")))))
