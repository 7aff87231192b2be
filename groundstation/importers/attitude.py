"""Euler angles from the attitude quaternions of foreign logs, which turn north-east-down to body axes."""

from collections.abc import Mapping, Sequence
from dataclasses import replace

import numpy as np

from groundstation.flight.arrays import Array
from groundstation.importers.mapping import ColumnSource, Map
from groundstation.importers.series import Log, TimeSeries

QUATERNIONS = (
    tuple(f"q[{i}]" for i in range(4)),
    *(("q0", "q1", "q2", "q3"), ("qw", "qx", "qy", "qz"), ("q_w", "q_x", "q_y", "q_z")),
    tuple(f"quaternion_{i}" for i in range(4)),
    ("quat_w", "quat_x", "quat_y", "quat_z"),
)
"""Names of the four elements, scalar first, after the name of a topic if there is one."""
AMBIGUOUS = (QUATERNIONS[0], ("q0", "q1", "q2", "q3"), ("q1", "q2", "q3", "q4"), QUATERNIONS[4])
"""Names that do not show which element is the scalar: usually the first, in some programs the last."""
LEAST_CORRELATION, LEAST_DIFFERENCE = 0.6, 0.3
"""Correlation of the quaternion's rates with the gyros for "scalar last", and its excess over that for "scalar first"."""
AVERAGE = 0.3  # [s] over which the rates of a noisy attitude are averaged
FEWEST_ROWS = 50  # for a correlation
_SHORTEST_INTERVAL = 1e-6  # [s] guards the division where stamps repeat
ANGLES = {"phi": "roll", "theta": "pitch", "psi": "yaw"}  # flight column -> name of its series
UNIT_TOLERANCE = 0.05  # of the median norm about 1, for four columns to be a quaternion of attitude


def euler_from_quaternion(w: Array, x: Array, y: Array, z: Array) -> dict[str, Array]:
    """Roll, pitch and yaw [rad], each (n,), from a quaternion with scalar w. Without scipy's Rotation, which takes longer to
    import than a log to read."""
    return {
        "roll": np.arctan2(2 * (w * x + y * z), 1 - 2 * (x * x + y * y)),
        "pitch": np.arcsin(np.clip(2 * (w * y - z * x), -1.0, 1.0)),
        "yaw": np.arctan2(2 * (w * z + x * y), 1 - 2 * (y * y + z * z)),
    }


@np.errstate(all="ignore")  # for values of any size in a damaged log
def with_attitudes(series: Mapping[str, TimeSeries]) -> dict[str, TimeSeries]:
    """The series, with `roll`, `pitch` and `yaw` [rad] added for each quaternion of attitude."""
    extended = dict(series)
    for head in dict.fromkeys(n.rpartition(".")[0] for n in series):
        prefix = f"{head}." if head else ""
        for names in QUATERNIONS:
            parts = [series[prefix + n] for n in names if prefix + n in series]
            if len(parts) < 4 or len({s.time.size for s in parts}) > 1:
                continue
            length = np.sqrt(sum((s.values**2 for s in parts), np.zeros(parts[0].time.size)))
            if not abs(float(np.nanmedian(length)) - 1.0) < UNIT_TOLERANCE:
                continue
            angles = euler_from_quaternion(*(s.values / np.where(length > 0, length, np.nan) for s in parts))
            for name, angle in angles.items():
                extended.setdefault(prefix + name, TimeSeries(parts[0].time, angle))
    return extended


def _gyro_correlation(log: Log, mapping: Map, names: Sequence[str]) -> float:
    """Correlation of a quaternion's body rates with the gyros, whose unit does not matter; 0 without gyros. names: series of the
    elements (w, v), scalar first. Rates: 2 (w dv/dt - dw/dt v - v x dv/dt)."""
    gyros = [log.series.get(mapping.columns[n][0].column or "") for n in "pqr" if n in mapping.columns]
    parts = [log.series[n] for n in names]
    time = parts[0].time
    available = [g for g in gyros if g is not None]
    if len(available) < 3 or time.size < FEWEST_ROWS:
        return 0.0
    w, *v = (p.values for p in parts)
    with np.errstate(all="ignore"):
        dw, *dv = (np.gradient(element, time) for element in (w, *v))
        cross = [v[1] * dv[2] - v[2] * dv[1], v[2] * dv[0] - v[0] * dv[2], v[0] * dv[1] - v[1] * dv[0]]
        rates = [2.0 * (w * dv[i] - dw * v[i] - cross[i]) for i in range(3)]
        width = max(round(AVERAGE / max(float(np.nanmedian(np.diff(time))), _SHORTEST_INTERVAL)), 1)
        window = np.full(min(width, time.size), 1.0 / width)
        pairs = [
            (np.convolve(r, window, "same"), np.convolve(g.values, window, "same"))
            for r, g in zip(rates, available, strict=True)
        ]
        x, y = np.concatenate([r for r, _ in pairs]), np.concatenate([g for _, g in pairs])
        use = np.isfinite(x) & np.isfinite(y)
        moves = use.sum() > FEWEST_ROWS and np.std(x[use]) > 0.0 and np.std(y[use]) > 0.0
        return float(np.corrcoef(x[use], y[use])[0, 1]) if moves else 0.0


def _scalar_last(log: Log, mapping: Map) -> tuple[str, ...] | None:
    """Names of a quaternion's elements, scalar first, where by the gyros the scalar is the last of them; None where it is the
    first or not determined, and without a quaternion of AMBIGUOUS names."""
    names = next((n for n in AMBIGUOUS if all(x in log.series for x in n)), None)
    if names is None:
        return None
    first, last = (_gyro_correlation(log, mapping, n) for n in (names, (names[3], *names[:3])))
    return (names[3], *names[:3]) if last > LEAST_CORRELATION and last > first + LEAST_DIFFERENCE else None


def with_quaternion(log: Log, mapping: Map) -> tuple[Log, Map]:
    """The log and mapping of a table, with phi, theta and psi from its quaternion where the mapping gives none of them; a note
    states the assumed order."""
    if any(angle in mapping.columns for angle in ANGLES):
        return log, mapping
    scalar_last = _scalar_last(log, mapping)
    renamed = dict(zip(scalar_last, AMBIGUOUS[0], strict=True)) if scalar_last else {}
    extended = with_attitudes({renamed.get(n, n): s for n, s in log.series.items()})
    extended = {**log.series, **{n: s for n, s in extended.items() if n not in renamed.values()}}
    new = [n for n in extended if n not in log.series]
    columns = {a: next((n for n in new if n.rpartition(".")[2] == word), "") for a, word in ANGLES.items()}
    if not all(columns.values()):
        return log, mapping
    sources = {a: (ColumnSource(column=n, unit="rad"),) for a, n in columns.items()}
    series = {n: s for n, s in extended.items() if n in log.series or n in columns.values()}
    kinds = {**log.kinds, **dict.fromkeys(columns.values(), "computed")}
    order = "scalar last, as the gyros turn," if scalar_last else "scalar first"
    note = f"phi, theta, psi are of the quaternion, taken as {order} and from north-east-down to the body"
    log = replace(log, series=series, kinds=kinds).with_notes(note)
    return log, mapping.model_copy(update={"columns": {**mapping.columns, **sources}})
