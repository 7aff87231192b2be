"""Sensors that fail in flight: a value stands still, or falls, while other sensors show that the quantity changed.

Each of `FOLLOWERS` is a signal and its rate by other sensors. Over blocks of some seconds, less a straight line, the signal of a
working sensor moves as the integral of the rate. One that has failed stands still where the integral moves by several times the
usual disagreement of the two. A sensor that failed before take-off is not found here, but by the other contradictions.
"""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass

import numpy as np

from daq.utilities.constants import GRAVITY
from groundstation.flight.airspeed import SHORTEST_LOSS, airspeed, lost_airspeed
from groundstation.flight.arrays import REPEATED, Array, Mask, alternates, true_runs
from groundstation.flight.contradictions.contradiction import Contradiction
from groundstation.flight.contradictions.fits import Columns
from groundstation.flight.contradictions.followers import FOLLOWERS, FORCE, RECONSTRUCT, Follower

FEWEST_ALIVE = 2  # blocks in which a sensor works, for it to have failed in flight
FEWEST_DEAD = 2  # blocks in which it stands still: in a fast manoeuvre the others may be wrong for one
CLEAR_MARGIN = 1.5  # factor on both limits below, beyond which one block is enough
LARGEST_STILL = 0.25  # of the movement by the other sensors: a slow or damped sensor moves more
LEAST_MOVEMENT = 3.5  # times the usual disagreement, of the other sensors
LEAST_CORRELATION = 0.7  # of a signal with its integrated rate, in a block in which the sensor works
FEWEST_SAMPLES = 8  # of a block
USUAL_STEP = 1.5  # of the 0.9 quantile of a slow sensor's intervals, up to which its samples are interpolated
GAP = 3.0  # sample intervals without a sample
MEANS_PER_BLOCK = 16  # of neighbouring samples, so that white noise hides no slow movement
SHORTEST_REST = 3.0  # [s] of the flight before, between or after failures, that is worth estimating from
STILL_BAND = 1.2  # times the largest movement of a failed sensor, within which it counts as still
FROZEN, FROZEN_SAMPLES = 2.0, 20  # [s] and samples of one value, from which a sensor with noise has failed
WEIGHTLESS, PARABOLA = 0.2 * GRAVITY, 3.0
"""No aeroplane flies with less specific force [m/s2] for longer [s]."""
OTHER_INSTANCE = "take another sensor's instance"
PITOT = ("V", "p_dynamic", "V_cas")
SENSED = ("ax", "ay", "az", "p", "q", "r", "phi", "theta", "psi", "alpha", "beta", "V", "p_dynamic")


def failing_sensors(time: Array, c: Columns) -> tuple[tuple[Contradiction, ...], dict[str, Array]]:
    """The contradictions of the sensors that fail in flight, and the columns with NaN where they do. time: (N,) [s];
    c: name -> (N,), SI."""
    columns = dict(c)
    contradictions: dict[tuple[str, ...], Contradiction] = {}
    cache: dict[str, tuple[Array, Array]] = {}

    def interpolated(name: str, values: Array) -> Array:
        """`_filled`, calculated once for a column that several followers need."""
        if name not in cache or cache[name][0] is not values:
            cache[name] = values, _filled(time, values)
        return cache[name][1]

    def add(sensors: tuple[str, ...], failed: Mask, contradiction: Contradiction) -> None:
        contradictions[sensors] = contradiction
        _mask_samples(columns, (*sensors, *(PITOT if set(PITOT) & set(sensors) else ())), failed)

    for names, failed in _frozen(time, columns).items():
        add(names, failed, _stood_still(time, names, (), failed, OTHER_INSTANCE))
    if (failed := _weightless(time, columns)).any():
        add(FORCE, failed, _stood_still(time, FORCE, (), failed, OTHER_INSTANCE))
    for follower in FOLLOWERS:
        if follower.failing == PITOT[:1] and (failed := lost_airspeed(time, columns)).any():
            add(PITOT, failed, _pitot_lost(time, columns, failed))
        speed = airspeed(columns)
        available = columns if speed is None else {"V": speed, **columns}
        if not all(n in available for n in follower.needs):
            continue
        filled = {n: interpolated(n, available[n]) for n in follower.needs}
        for sensors, failed in _still_sensors(time, follower, available, filled):
            if sensors not in contradictions and failed.any():
                witnesses = tuple(n for n in follower.needs if n not in sensors)
                add(sensors, failed, _stood_still(time, sensors, witnesses, failed, follower.cure))
    return tuple(contradictions.values()), columns


def _frozen(time: Array, c: Columns) -> dict[tuple[str, ...], Mask]:
    """Columns -> the samples (N,) at which they show one value while others change; only columns with noise elsewhere. Columns
    that freeze at the same samples, as those of one device do, share an entry."""
    masks: dict[bytes, tuple[tuple[str, ...], Mask]] = {}
    present = [n for n in SENSED if n in c]
    for name in present:
        mask = np.zeros(time.size, bool)
        starts = np.flatnonzero(np.diff(c[name], prepend=np.nan) != 0.0)
        stops = np.append(starts[1:], time.size)
        long = (stops - starts > FROZEN_SAMPLES) & (time[stops - 1] - time[starts] >= FROZEN)
        for a, b in zip(starts[long].tolist(), stops[long].tolist(), strict=True):
            mask[a:b] = any(np.ptp(c[n][a:b]) > 0.0 for n in present if n != name)
        alive = c[name][~mask & np.isfinite(c[name])]
        steps = np.diff(alive)
        if (
            mask.any()
            and alive.size > FROZEN_SAMPLES
            and np.mean(steps == 0.0) < REPEATED
            and alternates(np.diff(steps, 2))
        ):
            names, _ = masks.get(mask.tobytes(), ((), mask))
            masks[mask.tobytes()] = (*names, name), mask
    return dict(masks.values())


def _weightless(time: Array, c: Columns) -> Mask:
    """(N,) samples at which the accelerometers show almost no force for longer than a flown parabola lasts."""
    if not set(FORCE) <= c.keys():
        return np.zeros(time.size, bool)
    force = np.sqrt(c["ax"] ** 2 + c["ay"] ** 2 + c["az"] ** 2)
    weightless = np.zeros(time.size, bool)
    for a, b in true_runs(force < WEIGHTLESS):
        weightless[a:b] = time[b - 1] - time[a] >= PARABOLA and not _pushes_over(c, slice(a, b))
    return weightless & bool(np.nanmax(force) > 0.5 * GRAVITY)  # else they never worked in this flight


def _pushes_over(c: Columns, run: slice) -> bool:
    """Whether the path curves down as in weightless flight, where q V = -g; True, too, where q or V is not measured."""
    if not {"q", "V"} <= c.keys():
        return True
    return not float(np.nanmedian(c["q"][run] * c["V"][run])) > -0.5 * GRAVITY


def _still_sensors(
    time: Array, follower: Follower, c: Columns, filled: Columns
) -> Iterator[tuple[tuple[str, ...], Mask]]:
    """Each of the two groups of sensors of a follower with the samples (N,) at which it stands still. filled: the columns that
    the follower needs, interpolated over the gaps of slow sensors."""
    filled = {**filled, **{n: c[n] for n in ("alpha", "beta") if n in c}}
    size = max(round(follower.block / float(np.median(np.diff(time)))), 1)
    blocks = [_Blocks.of(time, signal, integrated, size) for signal, integrated in follower.pairs(time, filled)]
    for sensors, side in ((follower.failing, 0), (follower.drivers, 1)):
        dead = np.all([b.dead(side) | ~b.evident(side) for b in blocks], axis=0)
        dead &= np.any([b.dead(side) for b in blocks], axis=0)
        alive = np.any([b.follows for b in blocks], axis=0)
        if not sensors or alive.sum() < FEWEST_ALIVE or not dead.any():
            continue
        clear = np.any([b.dead(side, CLEAR_MARGIN) for b in blocks], axis=0)
        runs = [(a, b) for a, b in _bridged(dead, alive) if dead[a:b].sum() >= FEWEST_DEAD or (dead & clear)[a:b].any()]
        yield sensors, _to_samples(time, [c[n] for n in sensors], runs, size)


@dataclass(frozen=True)
class _Blocks:
    """movement: rms (m,) of signal and of integral in each block, less a straight line, NaN where samples are missing; follows:
    (m,) whether the two correlate; disagreement: median rms of their difference where they do, infinite without such a block."""

    movement: tuple[Array, Array]
    follows: Mask
    disagreement: float

    @classmethod
    def of(cls, time: Array, signal: Array, integrated: Array, size: int) -> "_Blocks":
        """The blocks of `size` samples of a signal and its integrated rate, both (N,)."""
        count, width = time.size // size, max(size // MEANS_PER_BLOCK, 1)
        with np.errstate(invalid="ignore"):
            x, y = (_without_line(_means(v[: count * size].reshape(count, size), width)) for v in (signal, integrated))
            steps = np.diff(time[: count * size].reshape(count, size), axis=1)
            complete = np.isfinite(x).all(axis=1) & np.isfinite(y).all(axis=1) & (size >= FEWEST_SAMPLES)
            averaged = float(np.median(steps.sum(axis=1))) / MEANS_PER_BLOCK if count else 0.0
            longest = max(GAP * float(np.median(steps)), averaged) if count else 0.0
            complete &= steps.max(axis=1, initial=0.0) <= longest  # the movement across a gap is unknown
            a, b, difference = (np.where(complete, np.sqrt(np.mean(v**2, axis=1)), np.nan) for v in (x, y, x - y))
            follows = complete & (np.mean(x * y, axis=1) > LEAST_CORRELATION * a * b)
        return cls((a, b), follows, float(np.median(difference[follows])) if follows.any() else np.inf)

    def evident(self, side: int, margin: float = 1.0) -> Mask:
        """(m,) blocks in which the other side moves enough to judge this one. side: 0 the signal, 1 the integral."""
        return np.nan_to_num(self.movement[1 - side]) > margin * LEAST_MOVEMENT * self.disagreement

    def dead(self, side: int, margin: float = 1.0) -> Mask:
        """(m,) blocks in which one side stands still, and the other moves."""
        with np.errstate(invalid="ignore"):
            return self.evident(side, margin) & (self.movement[side] < LARGEST_STILL / margin * self.movement[1 - side])


def _means(rows: Array, width: int) -> Array:
    """(m, n // width) means of `width` neighbours in each row of (m, n)."""
    m, n = rows.shape
    return np.asarray(rows[:, : n - n % width].reshape(m, n // width, width).mean(axis=2))


def _without_line(rows: Array) -> Array:
    """(m, n) less the straight line fitted to each row."""
    n = rows.shape[1]
    trend = np.linspace(-1.0, 1.0, n)
    level = rows - rows.mean(axis=1, keepdims=True)
    return np.asarray(level - np.outer(level @ trend, trend) / max(float(trend @ trend), 1e-12))


def _bridged(dead: Mask, alive: Mask) -> list[tuple[int, int]]:
    """Runs [start, stop) of dead blocks, joined across blocks that are neither dead nor alive."""
    runs: list[tuple[int, int]] = []
    for a, b in true_runs(dead):
        if runs and not alive[runs[-1][1] : a].any():
            runs[-1] = (runs[-1][0], b)
        else:
            runs.append((a, b))
    return runs


def _to_samples(time: Array, values: Sequence[Array], runs: Sequence[tuple[int, int]], size: int) -> Mask:
    """(N,) the samples of the runs of blocks, extended on either side for as long as all columns stay at their level."""
    mask = np.zeros(time.size, bool)
    for a, b in runs:
        start, stop = a * size, b * size
        still = np.ones(time.size, bool)
        for v in values:
            level = float(np.nanmedian(v[start:stop]))
            band = STILL_BAND * float(np.nanmax(np.abs(v[start:stop] - level))) + 1e-9 * abs(level)
            still &= ~(np.abs(v - level) > band)
        moving = np.flatnonzero(~still)
        first = int(moving[moving < start].max(initial=-1)) + 1
        last = int(moving[moving >= stop].min(initial=time.size))
        mask[first:last] = time[last - 1] - time[first] >= SHORTEST_LOSS
    return mask


def _pitot_lost(time: Array, c: Columns, lost: Mask) -> Contradiction:
    """The contradiction of a pitot that lost its pressure at the samples `lost` (N,)."""
    speed = airspeed(c)
    assert speed is not None
    ground = np.hypot(c["vn"], c["ve"])[lost] if {"vn", "ve"} <= c.keys() else np.full(1, np.nan)
    witness = (
        f"the speed over ground is {np.nanmedian(ground):.3g} m/s"
        if np.isfinite(ground).any()
        else "neither ax nor theta slows the aircraft"
    )
    name = next(n for n in PITOT if n in c)
    text = (
        f"{name} is that of {np.nanmedian(speed[lost]):.2g} m/s {_times(time, lost)} while {witness}: the pitot blocked (water, "
        f"ice) or lost its tube there; {_leave_out(time, lost, RECONSTRUCT)}"
    )
    sides = (name, "vn", "ve") if np.isfinite(ground).any() else (name, "ax", "theta")
    return _failed(sides, text, time, lost)


def _stood_still(
    time: Array, sensors: tuple[str, ...], witnesses: tuple[str, ...], still: Mask, cure: str
) -> Contradiction:
    """The contradiction of sensors that show one value at the samples `still` (N,), while the witnesses change."""
    stand, them = ("stand", "them") if len(sensors) > 1 else ("stands", "it")
    while_others = f"{', '.join(witnesses)} make {them} move" if witnesses else "the other sensors go on"
    text = (
        f"{', '.join(sensors)} {stand} still {_times(time, still)} while {while_others}: frozen, blocked or old values; "
        f"{_leave_out(time, still, cure)}"
    )
    return _failed((*sensors, *witnesses), text, time, still)


def _failed(sides: tuple[str, ...], text: str, time: Array, failed: Mask) -> Contradiction:
    spans = tuple((float(time[a]), float(time[b - 1])) for a, b in true_runs(failed))
    moves = f"what is estimated with {sides[0]} of that time"
    return Contradiction(sides, text, favoured=", ".join(sides[1:]), moves=moves, stops=True, spans=spans)


def _times(time: Array, failed: Mask) -> str:
    """The times of the runs of True as text."""
    return " and ".join(f"from {time[a]:.1f} to {time[b - 1]:.1f} s" for a, b in true_runs(failed))


def _leave_out(time: Array, failed: Mask, cure: str) -> str:
    """The remedy as text: the stretches without the failure in the form of `--segments`, and `cure`."""
    sound_spans = [(time[a], time[b - 1]) for a, b in true_runs(~failed) if time[b - 1] - time[a] >= SHORTEST_REST]
    stretches = ",".join(f"{np.ceil(a * 10) / 10:.1f}:{np.floor(b * 10) / 10:.1f}" for a, b in sound_spans)
    return f"leave it out with --segments {stretches}, {cure}" if sound_spans else cure.removeprefix("or ")


def _mask_samples(columns: dict[str, Array], names: Sequence[str], rows: Mask) -> None:
    """Replace some columns by copies with NaN at the samples `rows` (N,)."""
    for name in names:
        if name in columns:
            columns[name] = np.where(rows, np.nan, columns[name])


def _filled(time: Array, values: Array) -> Array:
    """The values (N,), linearly interpolated between the samples of a slow sensor; longer gaps stay NaN."""
    known = np.isfinite(values)
    if known.all() or known.sum() < 2:
        return values
    steps = np.diff(time[known])
    longest = USUAL_STEP * float(np.quantile(steps, 0.9))
    filled = np.interp(time, time[known], values[known], left=np.nan, right=np.nan)
    after = np.clip(np.searchsorted(time[known], time, "left"), 1, int(known.sum()) - 1)
    return np.where(known | (steps[after - 1] <= longest), filled, np.nan)
