"""Whether an IMU sits turned in the aircraft against the axes that its columns claim: a box of right angles has 24 ways to.

Attitude, gyros and accelerometers of a turned IMU agree with each other. What tells is the airspeed, which vanes give in body
axes: it changes as specific force, gravity and the turning of the axes make it change (Klein and Morelli, eq. 3.35).
"""

from collections.abc import Iterable, Iterator, Mapping
from itertools import permutations, product

import numpy as np

from daq.utilities.constants import GRAVITY
from groundstation.flight.arrays import Array, integral, slope_and_agreement, windows
from groundstation.flight.findings import Finding, FindingKind

Axes = tuple[str, ...]
"""Of the IMU, as recorded, that lie along body x, y and z."""

AS_CLAIMED: Axes = ("+x", "+y", "+z")
FORCE, RATES, ATTITUDE = ("ax", "ay", "az"), ("p", "q", "r"), ("phi", "theta")
LARGEST_PITCH = 1.6
"""[rad] A larger one is in degrees; so is a bank or a vane twice as large."""
EXPLAINS = 0.25
"""Share of the airspeed's change that the right axes explain at least: 0.63 to 0.85 in light gusts with attitude of a filter, 0.3
where that filter was misled by an IMU on its back."""
LESS = 0.5
"""Any other axes, those claimed included, explain less than this share of it: 0.0 to 0.17 in simulated flights."""
REVERSALS = (("beta",), ("alpha",), ("p", "phi"), ("phi",), ("q", "theta"), ("r",))
"""Columns of which one wrong sign does much the same; `plausibility` asks for them."""
AS_A_SIGN = 0.75
"""A wrong sign explains less than this share of it, else it is the simpler cause: two thirds with an IMU half a turn about z."""
UPRIGHT = 0.5  # cosine of the mean tilt; axes with which the whole flight would have been flown on its back are none
SLOPE = (0.7, 1.4)  # of what is explained: scales of uncalibrated vanes lie within


def turned_imu(time: Array, columns: Mapping[str, Array]) -> Iterator[Finding]:
    """The axes in which an IMU sits, where they are not those that it claims and the flight's motion tells."""
    with_attitude, alone = (explained(time, columns, attitude_turns=turns) for turns in (True, False))
    shares = max(with_attitude, alone, key=lambda found: max(found.values(), default=0.0))
    if not shares:
        return
    best, second = sorted(shares, key=lambda axes: shares[axes], reverse=True)[:2]
    if best == AS_CLAIMED or shares[best] < EXPLAINS or shares[second] > LESS * shares[best]:
        return
    if _sign_explains(time, columns) < AS_A_SIGN * shares[best]:
        yield _turned(best, (*RATES, *FORCE, *(ATTITUDE if shares is with_attitude else ())))


def _sign_explains(time: Array, c: Mapping[str, Array]) -> float:
    """Share that the axes as claimed explain with the one wrong sign that explains most."""
    reversed_signs = ({**c, **{n: -c[n] for n in signs}} for signs in REVERSALS)
    return max(explained(time, r, attitude_turns=True, among=[AS_CLAIMED])[AS_CLAIMED] for r in reversed_signs)


def _turned(axes: Axes, columns: tuple[str, ...]) -> Finding:
    matrix = TURNS[axes].astype(int).tolist()
    text = (
        f"{', '.join(columns)}: the IMU sits turned: what it recorded as {', '.join(axes)} lies along the aircraft's x, y, z. "
        f"Turn it by matrix = {matrix} in gyro.toml, accelerometer.toml and magnetometer.toml and boresight = {boresight(axes)} "
        "in attitude.toml, or by the map of the import; then correct its mounting"
    )
    return Finding(FindingKind.UNLIKELY, text, columns=columns)


def boresight(axes: Axes) -> list[float]:
    """Roll, pitch and yaw [rad] of the recorded axes from the body axes, as attitude.toml states them."""
    m = TURNS[axes]  # its columns are the recorded axes in body axes
    if m[2, 0]:  # nose up or down: roll and yaw are one turn
        roll, yaw = 0.0, np.arctan2(-m[0, 1], m[1, 1])
    else:
        roll, yaw = np.arctan2(m[2, 1], m[2, 2]), np.arctan2(m[1, 0], m[0, 0])
    return [round(float(angle), 4) + 0.0 for angle in (roll, -np.arcsin(m[2, 0]), yaw)]


def _turns() -> dict[Axes, Array]:
    """Axes -> the matrix (3, 3) that gives body axes of the recorded ones: the 24 that are rotations."""
    found = {}
    for order, signs in product(permutations(range(3)), product((1.0, -1.0), repeat=3)):
        matrix = np.zeros((3, 3))
        matrix[range(3), order] = signs
        if np.linalg.det(matrix) > 0.0:
            found[tuple(f"{'+' if s > 0 else '-'}{'xyz'[i]}" for i, s in zip(order, signs, strict=True))] = matrix
    return found


TURNS = _turns()


def explained(
    time: Array, c: Mapping[str, Array], *, attitude_turns: bool, among: Iterable[Axes] = tuple(TURNS)
) -> dict[Axes, float]:
    """Share of the airspeed's change that specific force and gravity explain with the IMU in each way; none where a column for
    it is not measured. attitude_turns: attitude is that of the IMU's axes too, not another's in body axes."""
    if not all(n in c for n in (*FORCE, *RATES, *ATTITUDE, "V", "alpha", "beta")):
        return {}
    angles = {"theta": 1.0, "phi": 2.0, "alpha": 1.0, "beta": 1.0}
    if any(float(np.nanmax(np.abs(c[n]))) > LARGEST_PITCH * most for n, most in angles.items()):
        return {}
    (sa, sb, st, sf), (ca, cb, ct, cf) = (
        [f(c[n]) for n in ("alpha", "beta", "theta", "phi")] for f in (np.sin, np.cos)
    )
    air = c["V"] * np.array([ca * cb, sb, sa * cb])
    down = np.array([-st, sf * ct, cf * ct])
    signals = (*air, *down, *(c[n] for n in (*FORCE, *RATES)))
    parts = [(t, np.array(rows).reshape(4, 3, -1)) for t, *rows in windows(time, *signals)]
    middle = np.nanmean(down, axis=1)
    found = dict.fromkeys(among, 0.0)
    for axes in found:
        turn, pairs = TURNS[axes], []
        if attitude_turns and float((turn @ middle)[2]) < UPRIGHT:
            continue
        for t, (velocity, gravity, force, rates) in parts:
            push = turn @ force + GRAVITY * (turn @ gravity if attitude_turns else gravity)
            turning = np.cross(turn @ rates, velocity, axis=0)
            pairs += [(integral(t, f), v + integral(t, w)) for f, v, w in zip(push, velocity, turning, strict=True)]
        slope, share = slope_and_agreement(pairs)
        found[axes] = share if SLOPE[0] < slope < SLOPE[1] else 0.0
    return found
