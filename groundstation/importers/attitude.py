"""Euler angles of the quaternions in foreign logs, scalar first, from north-east-down to the body."""

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
"""What the elements are called, scalar first, behind the name of a topic if there is one."""
COUNTED = (QUATERNIONS[0], ("q0", "q1", "q2", "q3"), ("q1", "q2", "q3", "q4"), QUATERNIONS[4])
"""Names that do not say which element is the scalar: that is the first as a rule, and the last with some."""
FOLLOWS, CLEARER = 0.6, 0.3
"""Correlation with the gyros from which one order is the right one, and by which it has to be the better one."""
SMOOTHED = 0.3  # [s] over which the slope of a noisy attitude is averaged
FEWEST_ROWS = 50
ANGLES = {"phi": "roll", "theta": "pitch", "psi": "yaw"}
UNIT_TOLERANCE = 0.05  # by which the length of a quaternion of an attitude may differ from 1


def euler_from_quaternion(w: Array, x: Array, y: Array, z: Array) -> dict[str, Array]:
    """Roll, pitch and yaw [rad]. Written out: scipy's Rotation takes longer to load than a log takes to read."""
    return {
        "roll": np.arctan2(2 * (w * x + y * z), 1 - 2 * (x * x + y * y)),
        "pitch": np.arcsin(np.clip(2 * (w * y - z * x), -1.0, 1.0)),
        "yaw": np.arctan2(2 * (w * z + x * y), 1 - 2 * (y * y + z * z)),
    }


@np.errstate(all="ignore")  # absurd values of a damaged log
def with_attitudes(series: Mapping[str, TimeSeries]) -> dict[str, TimeSeries]:
    """The series with `roll`, `pitch` and `yaw` [rad] beside each quaternion of attitude in them."""
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


def _turns_with_gyros(log: Log, mapping: Map, names: Sequence[str]) -> float:
    """Correlation of the rates of a quaternion, whose elements stand in this order, scalar first, with those of the gyros; 0
    without gyros. No unit is needed."""
    gyros = [log.series.get(mapping.columns[n][0].column or "") for n in "pqr" if n in mapping.columns]
    parts = [log.series[n] for n in names]
    time = parts[0].time
    known = [g for g in gyros if g is not None]
    if len(known) < 3 or time.size < FEWEST_ROWS:
        return 0.0
    w, *v = (p.values for p in parts)
    with np.errstate(all="ignore"):
        dw, *dv = (np.gradient(x, time) for x in (w, *v))
        cross = [v[1] * dv[2] - v[2] * dv[1], v[2] * dv[0] - v[0] * dv[2], v[0] * dv[1] - v[1] * dv[0]]
        rates = [2.0 * (w * dv[i] - dw * v[i] - cross[i]) for i in range(3)]
        width = max(round(SMOOTHED / max(float(np.nanmedian(np.diff(time))), 1e-6)), 1)
        window = np.full(min(width, time.size), 1.0 / width)
        pairs = [
            (np.convolve(r, window, "same"), np.convolve(g.values, window, "same"))
            for r, g in zip(rates, known, strict=True)
        ]
        both = np.concatenate([a for a, _ in pairs]), np.concatenate([b for _, b in pairs])
        use = np.isfinite(both[0]) & np.isfinite(both[1])
        moves = use.sum() > FEWEST_ROWS and np.std(both[0][use]) > 0.0 and np.std(both[1][use]) > 0.0
        return float(np.corrcoef(both[0][use], both[1][use])[0, 1]) if moves else 0.0


def _scalar_last(log: Log, mapping: Map) -> tuple[str, ...] | None:
    """The elements of a quaternion, whose names only count them, scalar first, where its scalar is the last by what the gyros
    turn; None where it is the first, or where nothing tells."""
    names = next((n for n in COUNTED if all(x in log.series for x in n)), None)
    if names is None:
        return None
    first, last = (_turns_with_gyros(log, mapping, n) for n in (names, (names[3], *names[:3])))
    return (names[3], *names[:3]) if last > FOLLOWS and last > first + CLEARER else None


def with_quaternion(log: Log, mapping: Map) -> tuple[Log, Map]:
    """The table with phi, theta and psi of its quaternion, where it has one and nothing else gives them; said in a note."""
    if any(angle in mapping.columns for angle in ANGLES):
        return log, mapping
    scalar_last = _scalar_last(log, mapping)
    renamed = dict(zip(scalar_last, COUNTED[0], strict=True)) if scalar_last else {}
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
