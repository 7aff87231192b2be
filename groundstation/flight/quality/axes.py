"""Columns in wrong axes: an IMU or gyro that is mounted turned in the aircraft, two columns exchanged, a reversed sign.

Attitude, gyros and accelerometers of a turned IMU agree with each other, but not with the airspeed vector, which vanes measure in
body axes. Its change must be that by specific force, gravity and rotation (Klein and Morelli, eq. 3.35). Each common mistake is
corrected in turn, and the one whose correction makes this hold is reported.
"""

from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass
from functools import partial
from itertools import permutations, product

import numpy as np

from daq.utilities.constants import GRAVITY
from groundstation.flight.arrays import Array, integral, slope_and_agreement, windows
from groundstation.flight.findings import Finding, FindingKind

Axes = tuple[str, ...]
"""The recorded axes of a sensor that lie along body x, y and z: ("+y", "-x", "+z")."""
Columns = Mapping[str, Array]

FORCE, RATES, ATTITUDE = ("ax", "ay", "az"), ("p", "q", "r"), ("phi", "theta")
FLOW = ("V", "alpha", "beta")
LARGEST_PITCH = 1.6
"""[rad]; a larger theta is in degrees, and so is a bank angle beyond twice that, or a vane beyond it."""
LEAST_SHARE, LEAST_SHARE_INVERTED = 0.5, 0.25
"""Least share of the airspeed's change that is explained after the correction: it is 0.63 to 0.85 in light gusts with the
attitude of a filter, and in rough air up to 0.29 by chance. Less is enough where the recorded attitude has the aircraft on its
side or back throughout: it is 0.3 where an IMU on its back misled the filter."""
SUFFICIENT_SHARE = 0.8
"""Share explained by the recorded columns, from which no mistake is looked for."""
UNCORRECTED_OVER_CORRECTED, MOST_REMAINING = 0.5, 1.0 / 3.0
"""A mistake is clear where the recorded columns explain less than half of the share after the correction (0 to 0.38 against 0.85
in light gusts), or where the correction leaves less than a third of what was unexplained."""
SECOND_OVER_BEST = 0.9
"""As UNCORRECTED_OVER_CORRECTED, for the second best correction: 0.86 for an exchange of columns where a gyro is turned."""
LEAST_UPRIGHT = 0.5  # mean cosine of the tilt: no flight is on its side or back throughout
CREDIBLE_SLOPE = (0.7, 1.4)  # of measured over explained change: scale errors of uncalibrated vanes lie within
EXCHANGES = (
    ("alpha", "beta"),
    ("p", "q"),
    ("q", "r"),
    ("p", "r"),
    ("phi", "theta"),
    ("ax", "ay"),
    ("ax", "az"),
    ("ay", "az"),
)
REVERSALS = (
    ("beta",),
    ("alpha",),
    ("p", "phi"),
    ("phi",),
    ("q", "theta"),
    ("theta",),
    *((n,) for n in (*RATES, *FORCE)),
)
"""Columns whose signs are reversed together; `plausibility` reports these."""


@dataclass(frozen=True, slots=True)
class Mistake:
    """columns: those in error. text: the mistake and its remedy; empty for a sign. undo: recorded columns -> corrected ones.
    axes: the mounting of a turned sensor; empty for other mistakes."""

    columns: tuple[str, ...]
    text: str
    undo: Callable[[Columns], dict[str, Array]]
    axes: Axes = ()


def wrong_axes(time: Array, columns: Columns) -> Iterator[Finding]:
    """The mistake in the axes of a flight, where its motion shows one clearly. time: (N,) [s]; columns: name -> (N,), SI; nothing
    without force, rates, attitude and the airspeed vector."""
    needed = (*FORCE, *RATES, *ATTITUDE, *FLOW)
    if not all(n in columns for n in needed) or not np.all([np.isfinite(columns[n]) for n in needed], axis=0).any():
        return
    if _in_degrees(columns):
        return
    upright = _upright(columns)
    uncorrected = explained(time, columns) if upright else 0.0
    if uncorrected > SUFFICIENT_SHARE:
        return
    shares = {m: explained(time, corrected) for m in MISTAKES if _upright(corrected := m.undo(columns))}
    if not shares:
        return
    best = max(shares, key=lambda m: shares[m])
    second_share = max(
        (s for m, s in shares.items() if m is not best and (m.axes != best.axes or not m.axes)), default=0.0
    )
    clear = _clearly_better(shares[best], uncorrected, UNCORRECTED_OVER_CORRECTED)
    clear = clear and _clearly_better(shares[best], second_share, SECOND_OVER_BEST)
    if best.text and clear and shares[best] > (LEAST_SHARE if upright else LEAST_SHARE_INVERTED):
        yield Finding(FindingKind.UNLIKELY, f"{', '.join(best.columns)}: {best.text}", columns=best.columns)


def _clearly_better(best: float, other: float, share: float) -> bool:
    """Whether another explained share is below `share` of the best, or leaves three times as much unexplained."""
    return other < share * best or 1.0 - best < MOST_REMAINING * (1.0 - other)


def explained(time: Array, c: Columns) -> float:
    """Share of the variance of the airspeed vector's change, in body axes, that specific force, gravity and rotation explain;
    0 where the slope between the two is not about 1."""
    (sa, sb, st, sf), (ca, cb, ct, cf) = (
        [f(c[n]) for n in ("alpha", "beta", "theta", "phi")] for f in (np.sin, np.cos)
    )
    air = c["V"] * np.array([ca * cb, sb, sa * cb])
    force = np.array([c[n] for n in FORCE]) + GRAVITY * np.array([-st, sf * ct, cf * ct])
    turning = np.cross(np.array([c[n] for n in RATES]), air, axis=0)
    slope, share = slope_and_agreement(
        (integral(t, rows[3 + i]), rows[i] + integral(t, rows[6 + i]))
        for t, *rows in windows(time, *air, *force, *turning)
        for i in range(3)
    )
    return share if CREDIBLE_SLOPE[0] < slope < CREDIBLE_SLOPE[1] else 0.0


def _in_degrees(c: Columns) -> bool:
    multiples = {"theta": 1.0, "phi": 2.0, "alpha": 1.0, "beta": 1.0}
    return any(float(np.nanmax(np.abs(c[n]))) > LARGEST_PITCH * times for n, times in multiples.items())


def _upright(c: Columns) -> bool:
    return bool(np.nanmean(np.cos(c["phi"]) * np.cos(c["theta"])) > LEAST_UPRIGHT)


def turned(c: Columns, axes: Axes, names: tuple[str, ...]) -> dict[str, Array]:
    """The columns with those of `names` turned to body axes, from a sensor whose recorded `axes` lie along body x, y and z."""
    matrix, in_body_axes = TURNS[axes], dict(c)
    for triad in (FORCE, RATES):
        if triad[0] in names:
            in_body_axes.update(zip(triad, matrix @ np.array([c[n] for n in triad]), strict=True))
    if ATTITUDE[0] in names:
        sin, cos = (f(np.array([c["phi"], c["theta"]])) for f in (np.sin, np.cos))
        down = matrix @ np.array([-sin[1], sin[0] * cos[1], cos[0] * cos[1]])
        in_body_axes.update(phi=np.arctan2(down[1], down[2]), theta=-np.arcsin(np.clip(down[0], -1.0, 1.0)))
    return in_body_axes


def _exchanged(c: Columns, a: str, b: str) -> dict[str, Array]:
    return {**c, a: c[b], b: c[a]}


def _reversed(c: Columns, names: tuple[str, ...]) -> dict[str, Array]:
    return {**c, **{n: -c[n] for n in names}}


def boresight(axes: Axes) -> list[float]:
    """Roll, pitch and yaw [rad] of the recorded axes from the body axes, as attitude.toml states them."""
    m = TURNS[axes]  # its columns are the recorded axes in body axes
    if m[2, 0]:  # nose up or down: roll and yaw are one turn
        roll, yaw = 0.0, np.arctan2(-m[0, 1], m[1, 1])
    else:
        roll, yaw = np.arctan2(m[2, 1], m[2, 2]), np.arctan2(m[1, 0], m[0, 0])
    return [round(float(angle), 4) + 0.0 for angle in (roll, -np.arcsin(m[2, 0]), yaw)]


def _turns() -> dict[Axes, Array]:
    """Axes -> the matrix (3, 3) from recorded to body axes, for the 24 rotations by right angles."""
    matrices = {}
    for order, signs in product(permutations(range(3)), product((1.0, -1.0), repeat=3)):
        matrix = np.zeros((3, 3))
        matrix[range(3), order] = signs
        if np.linalg.det(matrix) > 0.0:
            matrices[tuple(f"{'+' if s > 0 else '-'}{'xyz'[i]}" for i, s in zip(order, signs, strict=True))] = matrix
    return matrices


def _mistakes() -> Iterator[Mistake]:
    sensors = {
        (*RATES, *FORCE, *ATTITUDE): ("IMU sits", "gyro.toml, accelerometer.toml and magnetometer.toml"),
        (*RATES, *FORCE): ("IMU sits", "gyro.toml and accelerometer.toml"),
        RATES: ("gyros sit", "gyro.toml"),
        FORCE: ("accelerometers sit", "accelerometer.toml"),
    }
    for axes in list(TURNS)[1:]:
        for names, (subject, files) in sensors.items():
            level = f" and boresight = {boresight(axes)} in attitude.toml" if ATTITUDE[0] in names else ""
            matrix = TURNS[axes].astype(int).tolist()
            text = (
                f"the {subject} turned: what was recorded as {', '.join(axes)} lies along the aircraft's x, y, z. Turn it by "
                f"matrix = {matrix} in {files}{level}, or by the map of the import; then correct its mounting"
            )
            yield Mistake(names, text, partial(turned, axes=axes, names=names), axes)
    for a, b in EXCHANGES:
        text = "exchanged, they agree with the rest of the motion as they do not now: are the two columns mixed up?"
        yield Mistake((a, b), text, partial(_exchanged, a=a, b=b))
    for signs in REVERSALS:
        yield Mistake(signs, "", partial(_reversed, names=signs))


TURNS = _turns()  # the first is the identity
MISTAKES = tuple(_mistakes())
