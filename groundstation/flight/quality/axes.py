"""Columns in wrong axes: an IMU or gyro that is mounted turned in the aircraft, two columns exchanged, a reversed sign.

Attitude, gyros and accelerometers of a turned IMU agree with each other, but not with the airspeed vector, which vanes measure in
body axes. Its change must be that by specific force, gravity and rotation (Klein and Morelli, eq. 3.35). Each common mistake is
corrected in turn, and the one whose correction makes this hold is reported.
"""

from collections.abc import Iterator, Mapping
from dataclasses import dataclass, field
from itertools import permutations, product

import numpy as np

from daq.utilities.constants import GRAVITY
from groundstation.flight.arrays import Array, integral, slope_and_share, windows, without_line
from groundstation.flight.findings import Finding, FindingKind

Axes = tuple[str, ...]
"""The recorded axes of a sensor that lie along body x, y and z: ("+y", "-x", "+z")."""
Columns = Mapping[str, Array]

FORCE, RATES, ATTITUDE = ("ax", "ay", "az"), ("p", "q", "r"), ("phi", "theta")
FLOW = ("V", "alpha", "beta")
COLUMNS = {"force": FORCE, "rates": RATES, "down": ATTITUDE}
"""Vector -> the columns that give it."""
VECTORS = {"force": FORCE, "rates": RATES, "down": ("theta", "phi", ""), "air": ("", "beta", "alpha")}
"""Vector -> the column whose sign is that of its x, y and z component."""
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


@dataclass(frozen=True, slots=True, eq=False)
class Mistake:
    """columns: those in error. text: the mistake and its remedy; empty for a sign. axes: the mounting of a turned sensor; empty
    for other mistakes. turns: vector -> (3, 3) from recorded to corrected axes, of those that change. exchanged: whether the two
    columns are to be exchanged instead, which no matrix does to angles."""

    columns: tuple[str, ...]
    text: str
    axes: Axes = ()
    turns: Mapping[str, Array] = field(default_factory=dict)
    exchanged: bool = False

    def turn(self, vector: str) -> Array:
        return self.turns.get(vector, AS_IT_IS)


@dataclass(frozen=True)
class AirspeedKinematics:
    """How the airspeed vector changes, and what can explain it: corrected for any mistake, both combine the same integrals.

    products: (18, 18) sums of products, over all windows and with straight lines in time removed, of the airspeed vector [m/s]
    and the integrals of specific force, of gravity along body axes, and of rate i times airspeed j. down: (3,) mean of the unit
    vector that points down, in body axes.
    """

    products: Array
    down: Array

    @classmethod
    def of(cls, time: Array, c: Columns) -> "AirspeedKinematics":
        (sa, sb, st, sf), (ca, cb, ct, cf) = (
            [f(c[n]) for n in ("alpha", "beta", "theta", "phi")] for f in (np.sin, np.cos)
        )
        down = np.array([-st, sf * ct, cf * ct])
        signals = [c["V"] * ca * cb, c["V"] * sb, c["V"] * sa * cb, *(c[n] for n in (*FORCE, *RATES)), *down]
        products = np.zeros((18, 18))
        for t, *rows in windows(time, *signals):
            air, force, rates, gravity = rows[:3], rows[3:6], rows[6:9], GRAVITY * np.array(rows[9:])
            turning = [rate * speed for rate in rates for speed in air]
            change = np.column_stack([*air, integral(t, np.column_stack([*force, *gravity, *turning]))])
            straight = without_line(change)
            products += straight.T @ straight
        return cls(products, np.nanmean(down, axis=1))

    def is_upright(self, mistake: Mistake) -> bool:
        """Whether the aircraft is not on its side or back throughout, by the attitude corrected for a mistake."""
        return bool(mistake.turn("down")[2] @ self.down > LEAST_UPRIGHT)

    def explained(self, mistake: Mistake) -> float:
        """Share of the variance of the airspeed vector's change, in body axes, that specific force, gravity and rotation explain
        once a mistake is corrected; 0 where the slope between the two is not about 1."""
        change, cause = np.zeros((2, 3, 18))
        change[:, :3] = mistake.turn("air")
        change[:, 9:] = np.einsum("jki,jl,km->ilm", CROSS, mistake.turn("rates"), mistake.turn("air")).reshape(3, 9)
        cause[:, 3:6], cause[:, 6:9] = mistake.turn("force"), mistake.turn("down")
        pairs = (cause, cause), (cause, change), (change, change)
        slope, share = slope_and_share(*(float(np.sum((a @ self.products) * b)) for a, b in pairs))
        return share if CREDIBLE_SLOPE[0] < slope < CREDIBLE_SLOPE[1] else 0.0


def wrong_axes(time: Array, columns: Columns) -> Iterator[Finding]:
    """The mistake in the axes of a flight, where its motion shows one clearly. time: (N,) [s]; columns: name -> (N,), SI; nothing
    without force, rates, attitude and the airspeed vector."""
    needed = (*FORCE, *RATES, *ATTITUDE, *FLOW)
    if not all(n in columns for n in needed) or not np.all([np.isfinite(columns[n]) for n in needed], axis=0).any():
        return
    if _in_degrees(columns):
        return
    motion = AirspeedKinematics.of(time, columns)
    upright = motion.is_upright(AS_RECORDED)
    uncorrected = motion.explained(AS_RECORDED) if upright else 0.0
    if uncorrected > SUFFICIENT_SHARE:
        return
    shares = {}
    for mistake in MISTAKES:
        corrected = AirspeedKinematics.of(time, _exchanged(columns, *mistake.columns)) if mistake.exchanged else motion
        if corrected.is_upright(mistake):
            shares[mistake] = corrected.explained(mistake)
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


def _in_degrees(c: Columns) -> bool:
    multiples = {"theta": 1.0, "phi": 2.0, "alpha": 1.0, "beta": 1.0}
    return any(float(np.nanmax(np.abs(c[n]))) > LARGEST_PITCH * times for n, times in multiples.items())


def _exchanged(c: Columns, a: str, b: str) -> dict[str, Array]:
    return {**c, a: c[b], b: c[a]}


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
    sensors = (
        (("rates", "force", "down"), "IMU sits", "gyro.toml, accelerometer.toml and magnetometer.toml"),
        (("rates", "force"), "IMU sits", "gyro.toml and accelerometer.toml"),
        (("rates",), "gyros sit", "gyro.toml"),
        (("force",), "accelerometers sit", "accelerometer.toml"),
    )
    for axes in list(TURNS)[1:]:
        for vectors, subject, files in sensors:
            level = f" and boresight = {boresight(axes)} in attitude.toml" if "down" in vectors else ""
            matrix = TURNS[axes].astype(int).tolist()
            text = (
                f"the {subject} turned: what was recorded as {', '.join(axes)} lies along the aircraft's x, y, z. Turn it by "
                f"matrix = {matrix} in {files}{level}, or by the map of the import; then correct its mounting"
            )
            columns = tuple(n for vector in vectors for n in COLUMNS[vector])
            yield Mistake(columns, text, axes, dict.fromkeys(vectors, TURNS[axes]))
    for pair in EXCHANGES:
        text = "exchanged, they agree with the rest of the motion as they do not now: are the two columns mixed up?"
        yield Mistake(pair, text, exchanged=True)
    for names in REVERSALS:
        signs = {
            vector: np.diag([-1.0 if n in names else 1.0 for n in axes])
            for vector, axes in VECTORS.items()
            if set(axes) & set(names)
        }
        yield Mistake(names, "", turns=signs)


AS_IT_IS = np.eye(3)
CROSS = np.array([[np.cross(a, b) for b in np.eye(3)] for a in np.eye(3)])
"""(3, 3, 3): cross product of unit vectors j and k, its component i last."""
TURNS = _turns()  # the first is the identity
AS_RECORDED = Mistake((), "")
MISTAKES = tuple(_mistakes())
