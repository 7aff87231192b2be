"""Columns that stand for another axis than they claim: an IMU or gyro that sits turned in the aircraft, two columns exchanged.

Attitude, gyros and accelerometers of a turned IMU agree with each other. What tells is the airspeed, which vanes give in body
axes: it changes as specific force, gravity and the turning of the axes make it change (Klein and Morelli, eq. 3.35). Each
mistake that people make is undone in turn, and the one after which that holds is named.
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
"""Of a sensor, as recorded, that lie along body x, y and z."""
Columns = Mapping[str, Array]

FORCE, RATES, ATTITUDE = ("ax", "ay", "az"), ("p", "q", "r"), ("phi", "theta")
FLOW = ("V", "alpha", "beta")
LARGEST_PITCH = 1.6
"""[rad] A larger one is in degrees; so is a bank or a vane twice as large."""
EXPLAINS, EXPLAINS_UPRIGHT = 0.5, 0.25
"""Share of the airspeed's change that is explained once the mistake is undone, at least: 0.63 to 0.85 in light gusts with
attitude of a filter. In rough air chance explains up to 0.29. Less is enough where the columns as they are have the aircraft on
its side or back: 0.3 where a filter was misled by an IMU on its back."""
SOUND = 0.8
"""Share that the columns explain as they are, above which nothing is asked."""
LESS, UNDONE = 0.5, 1.0 / 3.0
"""A mistake is clear where the columns as they are explain less than half of what is explained once it is undone (0 to 0.38 of
0.85 in light gusts), or where a third of what they leave is left then."""
RUNNER_UP = 0.9
"""As LESS, of undoing another mistake: 0.86 where a gyro that is turned is taken for two columns exchanged."""
UPRIGHT = 0.5  # cosine of the mean tilt: no flight is on its side or back from end to end
SLOPE = (0.7, 1.4)  # of what is explained: scales of uncalibrated vanes lie within
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
"""Columns of a wrong sign, which `plausibility` asks for."""


@dataclass(frozen=True, slots=True)
class Mistake:
    """columns: that stand for others. text: what happened, and what puts it right; empty of a sign. undo: the columns as they
    should be. axes: how a sensor sits, where it is turned."""

    columns: tuple[str, ...]
    text: str
    undo: Callable[[Columns], dict[str, Array]]
    axes: Axes = ()


def wrong_axes(time: Array, columns: Columns) -> Iterator[Finding]:
    """The mistake in the axes of a flight that its motion gives away."""
    needed = (*FORCE, *RATES, *ATTITUDE, *FLOW)
    if not all(n in columns for n in needed) or not np.all([np.isfinite(columns[n]) for n in needed], axis=0).any():
        return
    if _in_degrees(columns):
        return
    upright = _upright(columns)
    claimed = explained(time, columns) if upright else 0.0
    if claimed > SOUND:
        return
    shares = {m: explained(time, undone) for m in MISTAKES if _upright(undone := m.undo(columns))}
    if not shares:
        return
    best = max(shares, key=lambda m: shares[m])
    others = max((s for m, s in shares.items() if m is not best and (m.axes != best.axes or not m.axes)), default=0.0)
    clear = _beyond(shares[best], claimed, LESS) and _beyond(shares[best], others, RUNNER_UP)
    if best.text and clear and shares[best] > (EXPLAINS if upright else EXPLAINS_UPRIGHT):
        yield Finding(FindingKind.UNLIKELY, f"{', '.join(best.columns)}: {best.text}", columns=best.columns)


def _beyond(best: float, other: float, share: float) -> bool:
    return other < share * best or 1.0 - best < UNDONE * (1.0 - other)


def explained(time: Array, c: Columns) -> float:
    """Share of the change of airspeed in body axes that specific force and gravity explain; 0 where the slope is not about 1."""
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
    return share if SLOPE[0] < slope < SLOPE[1] else 0.0


def _in_degrees(c: Columns) -> bool:
    most = {"theta": 1.0, "phi": 2.0, "alpha": 1.0, "beta": 1.0}
    return any(float(np.nanmax(np.abs(c[n]))) > LARGEST_PITCH * times for n, times in most.items())


def _upright(c: Columns) -> bool:
    return bool(np.nanmean(np.cos(c["phi"]) * np.cos(c["theta"])) > UPRIGHT)


def turned(c: Columns, axes: Axes, names: tuple[str, ...]) -> dict[str, Array]:
    """Columns of a flight in body axes, with those of `names` from a sensor whose recorded axes lie so along body x, y, z."""
    turn, found = TURNS[axes], dict(c)
    for triad in (FORCE, RATES):
        if triad[0] in names:
            found.update(zip(triad, turn @ np.array([c[n] for n in triad]), strict=True))
    if ATTITUDE[0] in names:
        sin, cos = (f(np.array([c["phi"], c["theta"]])) for f in (np.sin, np.cos))
        down = turn @ np.array([-sin[1], sin[0] * cos[1], cos[0] * cos[1]])
        found.update(phi=np.arctan2(down[1], down[2]), theta=-np.arcsin(np.clip(down[0], -1.0, 1.0)))
    return found


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
    """Axes -> the matrix (3, 3) that gives body axes of the recorded ones: the 24 ways in which a box of right angles sits."""
    found = {}
    for order, signs in product(permutations(range(3)), product((1.0, -1.0), repeat=3)):
        matrix = np.zeros((3, 3))
        matrix[range(3), order] = signs
        if np.linalg.det(matrix) > 0.0:
            found[tuple(f"{'+' if s > 0 else '-'}{'xyz'[i]}" for i, s in zip(order, signs, strict=True))] = matrix
    return found


def _mistakes() -> Iterator[Mistake]:
    sensors = {
        (*RATES, *FORCE, *ATTITUDE): ("IMU sits", "gyro.toml, accelerometer.toml and magnetometer.toml"),
        (*RATES, *FORCE): ("IMU sits", "gyro.toml and accelerometer.toml"),
        RATES: ("gyros sit", "gyro.toml"),
        FORCE: ("accelerometers sit", "accelerometer.toml"),
    }
    for axes in list(TURNS)[1:]:
        for names, (who, files) in sensors.items():
            level = f" and boresight = {boresight(axes)} in attitude.toml" if ATTITUDE[0] in names else ""
            matrix = TURNS[axes].astype(int).tolist()
            text = (
                f"the {who} turned: what was recorded as {', '.join(axes)} lies along the aircraft's x, y, z. Turn it by "
                f"matrix = {matrix} in {files}{level}, or by the map of the import; then correct its mounting"
            )
            yield Mistake(names, text, partial(turned, axes=axes, names=names), axes)
    for a, b in EXCHANGES:
        text = "exchanged, they agree with the rest of the motion as they do not now: are the two columns mixed up?"
        yield Mistake((a, b), text, partial(_exchanged, a=a, b=b))
    for signs in REVERSALS:
        yield Mistake(signs, "", partial(_reversed, names=signs))


TURNS = _turns()  # the first is as claimed
MISTAKES = tuple(_mistakes())
