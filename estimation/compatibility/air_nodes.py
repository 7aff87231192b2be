"""From a flight to the nodes of the air-data filter: smoothed attitude, integrated velocity, fixes and airspeed."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

from daq.utilities.constants import GRAVITY
from estimation.compatibility.air_filter import INTERVAL, Nodes
from estimation.compatibility.records import (
    SHORTEST,
    attitude_jumps,
    finite_values,
    short_stretches,
    unbroken_stretches,
)
from estimation.errors import DataError
from estimation.signals.denoise import noise_level
from groundstation.flight import Array, Flight
from groundstation.flight.airspeed import FLYING
from groundstation.flight.arrays import integral
from groundstation.flight.kinematics import attitude_rates

INERTIAL = ("ax", "ay", "az", "p", "q", "r", "phi", "theta", "psi")
FIX = ("vn", "ve", "vd")

SMOOTH_S = 1.0
"""[s] up to which the gyro has the change of attitude better than the attitude itself; its noise over 1 s is 0.001 rad."""

FEWEST_FOR_RATE = 4  # samples from which the rate of a channel is estimated: below, every one counts as new
LEAST_BEND, LEAST_SIZE = 1e-6, 1e-3
"""Second difference, over the size of the channel (at least LEAST_SIZE), from which neighbouring samples lie on no straight
line."""
ALL_BEND = 0.8
"""Share of samples off straight lines from which every sample counts as measured."""
LEAST_SHARE = 0.01
"""Share of samples off straight lines that is assumed at least."""


@dataclass(frozen=True)
class AirStretch:
    """Samples `rows` of a flight without a gap: velocity (n, 3) integrated from the specific force, NED [m/s]; axes (n, 3, 3)
    body axes as columns, NED; nodes: of the filter."""

    rows: slice
    velocity: Array
    axes: Array
    nodes: Nodes


def stretches_of(flight: Flight, airspeed: Array, fix_age: float = 0.0) -> tuple[list[AirStretch], list[str]]:
    """Stretches in flight with the inertial motion measured; and notes on what is left out. airspeed: (N,) true [m/s]. fix_age:
    of a velocity fix at its time stamp [s].

    Raises DataError when no stretch is long enough or none has a fix and an airspeed.
    """
    complete = np.all(np.isfinite(np.column_stack([flight[c] for c in INERTIAL])), axis=1)
    with np.errstate(invalid="ignore"):
        usable = complete & ~(airspeed < FLYING)
    fixes, speeds = fresh_samples(flight, FIX), fresh_values(flight, "V", airspeed)
    stretches: list[AirStretch] = []
    short: list[slice] = []
    for first, last in unbroken_stretches(flight, usable, attitude_jumps(flight)):
        rows = slice(first, last)
        if last - first < SHORTEST or not (fixes[rows].any() and speeds[rows].any()):
            short.append(rows)
            continue
        stretches.append(_stretch(flight, rows, airspeed, fixes, speeds, fix_age))
    notes = short_stretches(flight, short, "too short a stretch, or no velocity fix or airspeed in it")
    if not stretches:
        raise DataError(
            f"{flight.name}: no {SHORTEST} samples in a row, in flight, with {', '.join(INERTIAL)} all measured and "
            f"{', '.join(FIX)} and airspeed among them; nothing to reconstruct the air data from"
        )
    return stretches, notes


def fresh_samples(flight: Flight, columns: Sequence[str]) -> NDArray[np.bool_]:
    """(N,) whether a row has a new sample of `columns`, channels that are sampled together, maybe slower than the flight.

    Their rate is the one that the import states (`native_hz`); else repeated values count as held, and values on straight lines
    as interpolated.
    """
    values = np.column_stack([flight[c] for c in columns])
    complete = np.all(np.isfinite(values), axis=1)
    rows = np.flatnonzero(complete)
    if rows.size < FEWEST_FOR_RATE:
        return complete
    changed = np.any(np.diff(values[rows], axis=0) != 0.0, axis=1)
    candidates = rows[np.concatenate([[True], changed])]
    least_interval = _interval(flight, columns, values[rows])
    mask = np.zeros(len(flight), bool)
    last = -np.inf
    for row in candidates.tolist():
        if flight.time[row] - last >= least_interval:
            mask[row] = True
            last = float(flight.time[row])
    return mask


def _interval(flight: Flight, columns: Sequence[str], values: Array) -> float:
    """Least time between two new samples [s]."""
    rates = [rate for rate in map(flight.native_rate, columns) if rate is not None]
    dt = flight.sample_interval
    if rates:
        return max(1.0 / min(rates), dt) - 0.5 * dt
    bend = np.abs(np.diff(values, 2, axis=0)).max(axis=1)
    bending = bend > LEAST_BEND * max(float(np.median(np.abs(values).max(axis=1))), LEAST_SIZE)
    share = float(bending.mean())
    # interpolation bends at one or two rows of each interval: one is assumed, which makes fewer samples
    return 0.5 * dt if share > ALL_BEND else dt / max(share, LEAST_SHARE) - 0.5 * dt


def fresh_values(flight: Flight, column: str, values: Array) -> NDArray[np.bool_]:
    """(N,) whether a row has a new sample of `values`, which take the place of a column of the flight."""
    return fresh_samples(flight.with_columns(**{column: values}), (column,))


def _stretch(
    flight: Flight, rows: slice, airspeed: Array, fixes: NDArray[np.bool_], speeds: NDArray[np.bool_], fix_age: float
) -> AirStretch:
    time = flight.time[rows]
    phi, theta, psi = _attitude(flight, rows)
    axes = Rotation.from_euler("ZYX", np.column_stack([psi, theta, phi])).as_matrix()
    force = np.einsum("nij,nj->ni", axes, np.column_stack([flight[c][rows] for c in ("ax", "ay", "az")]))
    acceleration = force + np.array([0.0, 0.0, GRAVITY])
    fix = np.column_stack([flight[c][rows] for c in FIX])
    first = int(np.flatnonzero(fixes[rows])[0])
    velocity = integral(time, acceleration)
    velocity += fix[first] - velocity[first]
    node = _node_of(time)
    nodes = Nodes(
        time=_mean(time, node),
        velocity=_at_middle(velocity, time, node),
        mean_velocity=_mean(velocity, node, speeds[rows]),
        axes=_at_middle(axes.reshape(-1, 9), time, node).reshape(-1, 3, 3),
        force=_between(integral(time, force), time, node),
        turn=_between(integral(time, axes.reshape(-1, 9)), time, node).reshape(-1, 3, 3),
        acceleration=_mean(_earlier(acceleration, time, fix_age), node, fixes[rows]),
        speed_acceleration=_mean(acceleration, node, speeds[rows]),
        fix=_mean(fix - _earlier(velocity, time, fix_age), node, fixes[rows]),
        fixes=np.bincount(node, fixes[rows].astype(float)).astype(float),
        airspeed=_mean(airspeed[rows], node, speeds[rows]),
    )
    return AirStretch(rows, velocity, axes, nodes)


def _node_of(time: Array) -> NDArray[np.int64]:
    """(n,) the node of each sample; a last node shorter than half an interval joins the one before."""
    node = np.floor((time - time[0]) / INTERVAL + 1e-9).astype(np.int64)
    _, node = np.unique(node, return_inverse=True)
    if np.sum(node == node[-1]) * np.median(np.diff(time)) < 0.5 * INTERVAL and node[-1] > 0:
        node = np.minimum(node, node[-1] - 1)
    return node


def _mean(values: Array, node: NDArray[np.int64], use: NDArray[np.bool_] | None = None) -> Array:
    """Mean over the samples of each node where `use` is true; NaN where there is none."""
    flat = values.reshape(len(values), -1)
    weight = np.ones(len(values)) if use is None else use.astype(float)
    count = np.bincount(node, weight)
    sums = np.column_stack([np.bincount(node, np.where(weight > 0, column, 0.0)) for column in flat.T])
    with np.errstate(invalid="ignore"):
        means = sums / np.where(count > 0, count, np.nan)[:, None]
    return means[:, 0] if values.ndim == 1 else means


def _earlier(values: Array, time: Array, age: float) -> Array:
    """(n, m) the values `age` [s] before; at the start the first ones."""
    return values if age == 0.0 else np.column_stack([np.interp(time - age, time, column) for column in values.T])


def _at_middle(values: Array, time: Array, node: NDArray[np.int64]) -> Array:
    middle = _mean(time, node)
    return np.column_stack([np.interp(middle, time, column) for column in values.T])


def _between(integral: Array, time: Array, node: NDArray[np.int64]) -> Array:
    """Increase of an integral from the middle of the node before to that of each node; zeros for the first."""
    midpoints = _at_middle(integral, time, node)
    return np.vstack([np.zeros(midpoints.shape[1]), np.diff(midpoints, axis=0)])


def _attitude(flight: Flight, rows: slice) -> tuple[Array, Array, Array]:
    """phi, theta, psi [rad]: fast changes from the gyros, slow ones from the measured attitude."""
    time = flight.time[rows]
    angles = {c: np.unwrap(flight[c][rows]) for c in ("phi", "theta", "psi")}
    rates = attitude_rates(flight["p"][rows], flight["q"][rows], flight["r"][rows], angles["phi"], angles["theta"])
    phi, theta, psi = (_complementary(time, angle, rates[name]) for name, angle in angles.items())
    return phi, theta, psi


def _complementary(time: Array, angle: Array, rate: Array) -> Array:
    """A measured angle, de-noised with its measured rate: integral of the rate plus the smoothed difference."""
    from scipy.signal import savgol_filter

    fast = integral(time, rate)
    samples = 2 * max(1, round(0.5 * SMOOTH_S / float(np.median(np.diff(time))))) + 1
    window = min(samples, len(time) - 1 + len(time) % 2)
    return np.asarray(fast + savgol_filter(angle - fast, window, 1))


def measured_noise(flight: Flight, column: str, rows: NDArray[np.bool_]) -> float:
    """Sample-to-sample noise of a channel over its new samples `rows` (N,)."""
    return noise_level(finite_values(flight[column][rows]))
