"""Gyros against the body rates of the recorded attitude: a zero that jumps in flight, and axes that are exchanged."""

from collections.abc import Iterator

import numpy as np

from groundstation.flight.arrays import MAD_TO_SIGMA, Array
from groundstation.flight.contradictions.contradiction import Contradiction
from groundstation.flight.contradictions.fits import Columns
from groundstation.flight.kinematics import GYROS

BLOCK = 2.0  # [s] over which a rate and the change of its angle are averaged
FULL_SHARE = 0.8  # of a block's samples, that must be there
LEAST_BLOCKS = 5  # on either side of a jump
BLOCKS_AT_JUMP = 3  # blocks next to the jump, on either side, which must show it: a drift does not
LOCAL_SHARE = 0.7  # of the jump that these blocks must show
LEAST_JUMP = 0.015  # [rad/s] that is reported: zeros of gyros drift by a third of that in a flight
LEAST_JUMP_OVER_TURN = 0.2
"""Of the change of the mean rate: a scale error of 3 %, or an attitude that is wrong in turns, is no jump."""
LEAST_JUMP_OVER_SCATTER = 4.0  # standard deviations of the blocks
AVERAGE = 0.3  # [s] over which rates are averaged before they are correlated
LEAST_OTHER_AXIS, MOST_OWN_AXIS = 0.8, 0.3
"""Correlation of a gyro with another axis of the attitude, and with its own, of exchanged axes: in a Dutch roll p and r correlate
with each other, but each with its own axis as well."""


def gyros_beside_attitude(time: Array, c: Columns) -> Iterator[Contradiction]:
    """Contradictions between gyros and attitude. time: (N,) [s]; c: column -> (N,), SI; none without gyros and attitude."""
    if all(n in c for n in ("p", "q", "r", "phi", "theta", "psi")):
        rates = _rates_of_attitude(time, c)
        yield from _jumped_zeros(time, c, rates)
        yield from _exchanged_axes(time, c, rates)


def _jumped_zeros(time: Array, c: Columns, rates: Columns) -> Iterator[Contradiction]:
    """Each gyro whose zero changes at some instant, by its angle of attitude. rates: of the attitude, as p, q and r."""
    for angle, gyro in GYROS.items():
        starts, turn, error = _blocks(time, rates[gyro], c[gyro] - rates[gyro])
        jump = _jump(error, turn)
        if jump is None:
            continue
        k, step = jump
        before = f"{time[0]:.1f}:{starts[k] - BLOCK:.1f}"
        after = f"{starts[k] + BLOCK:.1f}:{time[-1]:.1f}"
        text = (
            f"{gyro} turns by {step:+.3f} rad/s more than {angle} does from {starts[k]:.0f} s on: its zero jumped; estimate "
            f"either part, --segments {before} or {after}"
        )
        moves = f"what is estimated with {gyro} over both parts"
        yield Contradiction((gyro, angle), text, None, step, "rad/s", favoured=angle, moves=moves)


def _exchanged_axes(time: Array, c: Columns, rates: Columns) -> Iterator[Contradiction]:
    """Each gyro that correlates with another axis of the attitude, and not with its own. rates: of the attitude."""
    width = max(round(AVERAGE / float(np.median(np.diff(time)))), 1)
    count = time.size // width
    means = {
        (kind, n): v[: count * width].reshape(count, width).mean(axis=1)
        for kind, signals in (("gyro", c), ("attitude", rates))
        for n, v in ((n, signals[n]) for n in "pqr")
    }
    known = np.all([np.isfinite(v) for v in means.values()], axis=0)
    if known.sum() < LEAST_BLOCKS * BLOCKS_AT_JUMP or any(np.std(v[known]) == 0.0 for v in means.values()):
        return
    correlation = np.corrcoef([means[kind, n][known] for kind in ("gyro", "attitude") for n in "pqr"])[:3, 3:]
    for i, gyro in enumerate("pqr"):
        k = int(np.argmax(np.abs(correlation[i])))
        if abs(correlation[i, i]) < MOST_OWN_AXIS and abs(correlation[i, k]) > LEAST_OTHER_AXIS:
            text = (
                f"{gyro} follows the rate about the axis of {'pqr'[k]} (correlation {correlation[i, k]:.2f}) and not about "
                f"its own ({correlation[i, i]:.2f}), by phi, theta and psi: are the axes of the gyros exchanged?"
            )
            yield Contradiction((gyro, "phi, theta, psi"), text, moves="every derivative", stops=True)


def _rates_of_attitude(time: Array, c: Columns) -> dict[str, Array]:
    """p, q, r (N,) [rad/s] of the recorded attitude (Etkin, eq. 4.4). A gyro's zero is its constant difference from them at any
    bank, which it would not be from the slopes of the angles."""
    slope = {n: np.gradient(np.interp(time, *_finite_samples(time, c[n])), time) for n in GYROS}
    sf, cf, st, ct = np.sin(c["phi"]), np.cos(c["phi"]), np.sin(c["theta"]), np.cos(c["theta"])
    return {
        "p": slope["phi"] - st * slope["psi"],
        "q": cf * slope["theta"] + sf * ct * slope["psi"],
        "r": -sf * slope["theta"] + cf * ct * slope["psi"],
    }


def _finite_samples(time: Array, angle: Array) -> tuple[Array, Array]:
    """Times and unwrapped angles of the finite samples."""
    known = np.isfinite(angle)
    return time[known], np.unwrap(angle[known])


def _blocks(time: Array, *signals: Array) -> tuple[Array, ...]:
    """Begin [s] and mean of each signal, (m,) over the blocks without a gap or a missing value."""
    step = float(np.median(np.diff(time)))
    edges = np.searchsorted(time, np.arange(time[0], time[-1], BLOCK))
    complete = np.diff(edges) > max(FULL_SHARE * BLOCK / step, 1.0)
    means = [
        np.add.reduceat(s, edges[:-1])[complete] / np.diff(edges)[complete] if complete.any() else np.zeros(0)
        for s in signals
    ]
    known = np.all([np.isfinite(m) for m in means], axis=0)
    return time[edges[:-1]][complete][known], *(m[known] for m in means)


def _jump(zero: Array, turn: Array) -> tuple[int, float] | None:
    """Number of the block at which the zero jumps, and the jump [rad/s]; None without a clear one. zero, turn: (m,) means of the
    gyro's error and of the rate by attitude [rad/s]. The jump is where two constants leave the smallest sum of squares."""
    if zero.size < 2 * LEAST_BLOCKS:
        return None
    count = np.arange(1, zero.size)
    sums, squares = np.cumsum(zero)[:-1], np.cumsum(zero**2)[:-1]
    sums_after, squares_after = zero.sum() - sums, np.sum(zero**2) - squares
    residual_squares = squares - sums**2 / count + squares_after - sums_after**2 / (zero.size - count)
    k = int(np.argmin(residual_squares[LEAST_BLOCKS - 1 : zero.size - LEAST_BLOCKS])) + LEAST_BLOCKS
    before, after = zero[:k], zero[k:]
    step = float(np.median(after) - np.median(before))
    scatter = MAD_TO_SIGMA * float(
        np.median(np.abs(np.concatenate([before - np.median(before), after - np.median(after)])))
    )
    local = float(np.median(after[:BLOCKS_AT_JUMP]) - np.median(before[-BLOCKS_AT_JUMP:]))
    rate_change = abs(float(np.mean(turn[k:]) - np.mean(turn[:k])))
    threshold = max(LEAST_JUMP, LEAST_JUMP_OVER_SCATTER * scatter, LEAST_JUMP_OVER_TURN * rate_change)
    return (k, step) if abs(step) > threshold and local / step > LOCAL_SHARE else None
