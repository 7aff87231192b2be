"""Gyros beside the rates that turn the attitude: one whose zero jumps in flight, and axes that are exchanged."""

from collections.abc import Iterator

import numpy as np

from groundstation.flight.arrays import Array
from groundstation.flight.contradictions.contradiction import Contradiction
from groundstation.flight.contradictions.fits import Columns
from groundstation.flight.kinematics import GYROS

BLOCK = 2.0  # [s] over which a rate and the change of its angle are averaged
FEWEST = 5  # blocks on either side
NEAR = 3  # blocks next to the jump, on either side, which must show it: a drift does not
SMALLEST = 0.015  # [rad/s] that is told: zeros of gyros wander by a third of that in a flight
SHARE_OF_TURN = 0.2
"""Of the change of the mean rate: a scale error of 3 %, and an attitude that is wrong in turns, are no jump."""
CLEAR = 4.0  # times the scatter of the blocks
SMOOTHED = 0.3  # [s] over which rates are averaged before they are compared
FOLLOWS, STRANGE = 0.8, 0.3
"""Correlation of a gyro with the rate of another axis, and with that of its own, that tell an exchange: p and r of a Dutch roll
follow each other, and each its own."""


def gyros_beside_attitude(time: Array, c: Columns) -> Iterator[Contradiction]:
    """What gyros say otherwise than the attitude that they turn."""
    if all(n in c for n in ("p", "q", "r", "phi", "theta", "psi")):
        rates = _rates_of_attitude(time, c)
        yield from _that_jump(time, c, rates)
        yield from _exchanged(time, c, rates)


def _that_jump(time: Array, c: Columns, rates: Columns) -> Iterator[Contradiction]:
    """Each gyro whose zero is another from some instant on, by its angle of attitude."""
    for angle, gyro in GYROS.items():
        begins, turn, more = _blocks(time, rates[gyro], c[gyro] - rates[gyro])
        jump = _jump(more, turn)
        if jump is None:
            continue
        k, step = jump
        before = f"{time[0]:.1f}:{begins[k] - BLOCK:.1f}"
        after = f"{begins[k] + BLOCK:.1f}:{time[-1]:.1f}"
        text = (
            f"{gyro} turns by {step:+.3f} rad/s more than {angle} does from {begins[k]:.0f} s on: its zero jumped; estimate "
            f"either part, --segments {before} or {after}"
        )
        moves = f"what is estimated with {gyro} over both parts"
        yield Contradiction((gyro, angle), text, None, step, "rad/s", favoured=angle, moves=moves)


def _exchanged(time: Array, c: Columns, rates: Columns) -> Iterator[Contradiction]:
    """Each gyro that turns as another axis of the attitude does, and not as its own."""
    each = max(round(SMOOTHED / float(np.median(np.diff(time)))), 1)
    count = time.size // each
    means = {
        (kind, n): v[: count * each].reshape(count, each).mean(axis=1)
        for kind, signals in (("gyro", c), ("attitude", rates))
        for n, v in ((n, signals[n]) for n in "pqr")
    }
    known = np.all([np.isfinite(v) for v in means.values()], axis=0)
    if known.sum() < FEWEST * NEAR or any(np.std(v[known]) == 0.0 for v in means.values()):
        return
    table = np.corrcoef([means[kind, n][known] for kind in ("gyro", "attitude") for n in "pqr"])[:3, 3:]
    for i, gyro in enumerate("pqr"):
        k = int(np.argmax(np.abs(table[i])))
        if abs(table[i, i]) < STRANGE and abs(table[i, k]) > FOLLOWS:
            text = (
                f"{gyro} follows the rate about the axis of {'pqr'[k]} (correlation {table[i, k]:.2f}) and not about its own "
                f"({table[i, i]:.2f}), by phi, theta and psi: are the axes of the gyros exchanged?"
            )
            yield Contradiction((gyro, "phi, theta, psi"), text, moves="every derivative", stops=True)


def _rates_of_attitude(time: Array, c: Columns) -> dict[str, Array]:
    """Body rates (N,) that turn the attitude as it was recorded (Etkin, eq. 4.4): beside them the zero of a gyro is a constant in
    any bank."""
    slope = {n: np.gradient(np.interp(time, *_known(time, c[n])), time) for n in GYROS}
    sf, cf, st, ct = np.sin(c["phi"]), np.cos(c["phi"]), np.sin(c["theta"]), np.cos(c["theta"])
    return {
        "p": slope["phi"] - st * slope["psi"],
        "q": cf * slope["theta"] + sf * ct * slope["psi"],
        "r": -sf * slope["theta"] + cf * ct * slope["psi"],
    }


def _known(time: Array, angle: Array) -> tuple[Array, Array]:
    known = np.isfinite(angle)
    return time[known], np.unwrap(angle[known])


def _blocks(time: Array, *signals: Array) -> tuple[Array, ...]:
    """Of each block without a gap: where it begins [s], and the mean of each signal in it (m,)."""
    step = float(np.median(np.diff(time)))
    edges = np.searchsorted(time, np.arange(time[0], time[-1], BLOCK))
    whole = np.diff(edges) > max(0.8 * BLOCK / step, 1.0)
    means = [
        np.add.reduceat(s, edges[:-1])[whole] / np.diff(edges)[whole] if whole.any() else np.zeros(0) for s in signals
    ]
    known = np.all([np.isfinite(m) for m in means], axis=0)
    return time[edges[:-1]][whole][known], *(m[known] for m in means)


def _jump(zero: Array, turn: Array) -> tuple[int, float] | None:
    """The block at which a jump begins and its size, where there is one."""
    if zero.size < 2 * FEWEST:
        return None
    count = np.arange(1, zero.size)
    sums, squares = np.cumsum(zero)[:-1], np.cumsum(zero**2)[:-1]
    rest, rest_squares = zero.sum() - sums, np.sum(zero**2) - squares
    left = squares - sums**2 / count + rest_squares - rest**2 / (zero.size - count)
    k = int(np.argmin(left[FEWEST - 1 : zero.size - FEWEST])) + FEWEST
    before, after = zero[:k], zero[k:]
    step = float(np.median(after) - np.median(before))
    scatter = 1.4826 * float(np.median(np.abs(np.concatenate([before - np.median(before), after - np.median(after)]))))
    local = float(np.median(after[:NEAR]) - np.median(before[-NEAR:]))
    turned = abs(float(np.mean(turn[k:]) - np.mean(turn[:k])))
    clear = abs(step) > max(SMALLEST, CLEAR * scatter, SHARE_OF_TURN * turned) and local / step > 0.7
    return (k, step) if clear else None
