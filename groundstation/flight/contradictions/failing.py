"""Sensors that fail in mid-air: a value stands still, or falls, while the rest of the flight says that it must have moved.

Each row of a table is a signal and its rate by other sensors. Over blocks of some seconds, straight lines removed, a sensor
that lives moves as the integral of the rate; one that has failed stands still where the integral moves by several times what
the two usually disagree by. A sensor that never lived is another contradiction.
"""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass

import numpy as np

from daq.utilities.constants import GRAVITY
from groundstation.flight.airspeed import LASTS, airspeed, lost_airspeed
from groundstation.flight.arrays import REPEATED, Array, Mask, alternates, true_runs
from groundstation.flight.contradictions.contradiction import Contradiction
from groundstation.flight.contradictions.fits import Columns
from groundstation.flight.contradictions.followers import FOLLOWERS, FORCE, RECONSTRUCT, Follower

FEWEST_ALIVE = 2  # blocks: a sensor that has lived
FEWEST_DEAD = 2  # blocks in which it stands still: the others are wrong for one where a manoeuvre is fast, but
CLEARLY = 1.5  # times more of either share below, one tells
FOLLOWS = 0.7  # correlation of a signal with its integrated rate, in a block in which it lives
STILL = 0.25  # of the movement that the others show: a slow or damped sensor moves more
EVIDENT = 3.5  # times the usual disagreement, that the others have to move by
FEWEST_SAMPLES = 8  # of a block
HOLE = 3.0  # sample intervals, or one of these means, from which samples are missing
MEANS = 16  # of neighbouring samples in a block, so that noise from sample to sample hides no slow movement
SHORTEST_REST = 3.0  # [s] of flight before, between or after failures that is worth naming
SPREAD = 1.2  # times the movement of a failed sensor, within which it is still failed
FROZEN, FROZEN_SAMPLES = 2.0, 20  # [s], samples of one value of a sensor with noise
WEIGHTLESS, PARABOLA = 0.2 * GRAVITY, 3.0  # [m/s2], [s] of a specific force that no aeroplane flies
PITOT = ("V", "p_dynamic", "V_cas")
SENSED = ("ax", "ay", "az", "p", "q", "r", "phi", "theta", "psi", "alpha", "beta", "V", "p_dynamic")


def failing_sensors(time: Array, c: Columns) -> tuple[tuple[Contradiction, ...], dict[str, Array]]:
    """What fails in mid-air, and the columns without the samples at which they do. time: (N,) [s]; c: name -> (N,)."""
    columns = dict(c)
    found: dict[tuple[str, ...], Contradiction] = {}
    fillings: dict[str, tuple[Array, Array]] = {}

    def known_or_filled(name: str, values: Array) -> Array:
        """`_filled`, once for columns that many rows need."""
        if name not in fillings or fillings[name][0] is not values:
            fillings[name] = values, _filled(time, values)
        return fillings[name][1]

    def fails(sensors: tuple[str, ...], failed: Mask, contradiction: Contradiction) -> None:
        found[sensors] = contradiction
        _forget(columns, (*sensors, *(PITOT if set(PITOT) & set(sensors) else ())), failed)

    for names, failed in _frozen(time, columns).items():
        fails(names, failed, _stood_still(time, names, (), failed, "take another sensor's instance"))
    if (failed := _weightless(time, columns)).any():
        fails(FORCE, failed, _stood_still(time, FORCE, (), failed, "take another sensor's instance"))
    for row in FOLLOWERS:
        if row.failing == PITOT[:1] and (failed := lost_airspeed(time, columns)).any():
            fails(PITOT, failed, _pitot_lost(time, columns, failed))
        speed = airspeed(columns)
        have = columns if speed is None else {"V": speed, **columns}
        if not all(n in have for n in row.needs):
            continue
        filled = {n: known_or_filled(n, have[n]) for n in row.needs}
        for sensors, failed in _standing(time, row, have, filled):
            if sensors not in found and failed.any():
                witnesses = tuple(n for n in row.needs if n not in sensors)
                fails(sensors, failed, _stood_still(time, sensors, witnesses, failed, row.cure))
    return tuple(found.values()), columns


def _frozen(time: Array, c: Columns) -> dict[tuple[str, ...], Mask]:
    """Sensors that have noise -> the runs (N,) in which they show one value while others go on; those of one device together."""
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
    """(N,) where the accelerometers show next to no force for longer than any parabola."""
    if not set(FORCE) <= c.keys():
        return np.zeros(time.size, bool)
    force = np.sqrt(c["ax"] ** 2 + c["ay"] ** 2 + c["az"] ** 2)
    light = np.zeros(time.size, bool)
    for a, b in true_runs(force < WEIGHTLESS):
        light[a:b] = time[b - 1] - time[a] >= PARABOLA and not _pushes_over(c, slice(a, b))
    return light & bool(np.nanmedian(force) > 0.5 * GRAVITY or np.nanmax(force) > 0.5 * GRAVITY)


def _pushes_over(c: Columns, run: slice) -> bool:
    """Whether the path bends down as it does without weight, or nothing tells: q V is then g."""
    if not {"q", "V"} <= c.keys():
        return True
    return not float(np.nanmedian(c["q"][run] * c["V"][run])) > -0.5 * GRAVITY


def _standing(time: Array, row: Follower, c: Columns, filled: Columns) -> Iterator[tuple[tuple[str, ...], Mask]]:
    """Each group of sensors of a row with the samples (N,) at which it stands still. filled: what the row needs of c."""
    filled = {**filled, **{n: c[n] for n in ("alpha", "beta") if n in c}}
    size = max(round(row.block / float(np.median(np.diff(time)))), 1)
    blocks = [_Blocks.of(time, signal, moved, size) for signal, moved in row.pairs(time, filled)]
    for sensors, side in ((row.failing, 0), (row.drivers, 1)):
        dead = np.all([b.dead(side) | ~b.evident(side) for b in blocks], axis=0)
        dead &= np.any([b.dead(side) for b in blocks], axis=0)
        alive = np.any([b.follows for b in blocks], axis=0)
        if not sensors or alive.sum() < FEWEST_ALIVE or not dead.any():
            continue
        clear = np.any([b.dead(side, CLEARLY) for b in blocks], axis=0)
        runs = [(a, b) for a, b in _bridged(dead, alive) if dead[a:b].sum() >= FEWEST_DEAD or (dead & clear)[a:b].any()]
        mask = _grown(time, [c[n] for n in sensors], runs, size)
        yield sensors, mask


@dataclass(frozen=True)
class _Blocks:
    """(m,) of each block: movement of the signal and of the integral, whether they follow each other, and what they usually
    disagree by."""

    moved: tuple[Array, Array]
    follows: Mask
    usual: float

    @classmethod
    def of(cls, time: Array, signal: Array, integrated: Array, size: int) -> "_Blocks":
        count, each = time.size // size, max(size // MEANS, 1)
        with np.errstate(invalid="ignore"):
            x, y = (_without_line(_means(v[: count * size].reshape(count, size), each)) for v in (signal, integrated))
            steps = np.diff(time[: count * size].reshape(count, size), axis=1)
            whole = np.isfinite(x).all(axis=1) & np.isfinite(y).all(axis=1) & (size >= FEWEST_SAMPLES)
            usual = max(HOLE * float(np.median(steps)), float(np.median(steps.sum(axis=1))) / MEANS) if count else 0.0
            whole &= steps.max(axis=1, initial=0.0) <= usual  # across a gap nothing is known of how they moved
            a, b, off = (np.where(whole, np.sqrt(np.mean(v**2, axis=1)), np.nan) for v in (x, y, x - y))
            follows = whole & (np.mean(x * y, axis=1) > FOLLOWS * a * b)
        return cls((a, b), follows, float(np.median(off[follows])) if follows.any() else np.inf)

    def evident(self, side: int, margin: float = 1.0) -> Mask:
        """Blocks in which the other side moves enough to tell."""
        return np.nan_to_num(self.moved[1 - side]) > margin * EVIDENT * self.usual

    def dead(self, side: int, margin: float = 1.0) -> Mask:
        """Blocks in which one side stands still, and the other moves."""
        with np.errstate(invalid="ignore"):
            return self.evident(side, margin) & (self.moved[side] < STILL / margin * self.moved[1 - side])


def _means(rows: Array, each: int) -> Array:
    """(m, n // each) means of so many neighbours of each row (n)."""
    m, n = rows.shape
    return np.asarray(rows[:, : n - n % each].reshape(m, n // each, each).mean(axis=2))


def _without_line(rows: Array) -> Array:
    """(m, n) less the straight line of each row."""
    n = rows.shape[1]
    trend = np.linspace(-1.0, 1.0, n)
    level = rows - rows.mean(axis=1, keepdims=True)
    return np.asarray(level - np.outer(level @ trend, trend) / max(float(trend @ trend), 1e-12))


def _bridged(dead: Mask, alive: Mask) -> list[tuple[int, int]]:
    """Runs [start, stop) of dead blocks, across those that tell nothing."""
    runs: list[tuple[int, int]] = []
    for a, b in true_runs(dead):
        if runs and not alive[runs[-1][1] : a].any():
            runs[-1] = (runs[-1][0], b)
        else:
            runs.append((a, b))
    return runs


def _grown(time: Array, values: Sequence[Array], runs: Sequence[tuple[int, int]], size: int) -> Mask:
    """(N,) the runs of blocks, grown to where the columns leave the level at which they stand."""
    mask = np.zeros(time.size, bool)
    for a, b in runs:
        start, stop = a * size, b * size
        near = np.ones(time.size, bool)
        for v in values:
            middle = float(np.nanmedian(v[start:stop]))
            band = SPREAD * float(np.nanmax(np.abs(v[start:stop] - middle))) + 1e-9 * abs(middle)
            near &= ~(np.abs(v - middle) > band)
        leaves = np.flatnonzero(~near)
        first = int(leaves[leaves < start].max(initial=-1)) + 1
        last = int(leaves[leaves >= stop].min(initial=time.size))
        mask[first:last] = time[last - 1] - time[first] >= LASTS
    return mask


def _pitot_lost(time: Array, c: Columns, lost: Mask) -> Contradiction:
    """A pitot that lost its pressure."""
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
        f"{name} is that of {np.nanmedian(speed[lost]):.2g} m/s {_when(time, lost)} while {witness}: the pitot blocked (water, "
        f"ice) or lost its tube there; {_leave_out(time, lost, RECONSTRUCT)}"
    )
    sides = (name, "vn", "ve") if np.isfinite(ground).any() else (name, "ax", "theta")
    return _failed(sides, text, time, lost)


def _stood_still(
    time: Array, sensors: tuple[str, ...], witnesses: tuple[str, ...], still: Mask, cure: str
) -> Contradiction:
    stand, them = ("stand", "them") if len(sensors) > 1 else ("stands", "it")
    while_others = f"{', '.join(witnesses)} make {them} move" if witnesses else "the other sensors go on"
    text = (
        f"{', '.join(sensors)} {stand} still {_when(time, still)} while {while_others}: frozen, blocked or old values; "
        f"{_leave_out(time, still, cure)}"
    )
    return _failed((*sensors, *witnesses), text, time, still)


def _failed(sides: tuple[str, ...], text: str, time: Array, failed: Mask) -> Contradiction:
    spans = tuple((float(time[a]), float(time[b - 1])) for a, b in true_runs(failed))
    moves = f"what is estimated with {sides[0]} of that time"
    return Contradiction(sides, text, favoured=", ".join(sides[1:]), moves=moves, stops=True, spans=spans)


def _when(time: Array, failed: Mask) -> str:
    return " and ".join(f"from {time[a]:.1f} to {time[b - 1]:.1f} s" for a, b in true_runs(failed))


def _leave_out(time: Array, failed: Mask, cure: str) -> str:
    """What to do: the stretches that are left, as `--segments` takes them."""
    rest = [(time[a], time[b - 1]) for a, b in true_runs(~failed) if time[b - 1] - time[a] >= SHORTEST_REST]
    stretches = ",".join(f"{np.ceil(a * 10) / 10:.1f}:{np.floor(b * 10) / 10:.1f}" for a, b in rest)
    return f"leave it out with --segments {stretches}, {cure}" if rest else cure.removeprefix("or ")


def _forget(columns: dict[str, Array], names: Sequence[str], rows: Mask) -> None:
    for name in names:
        if name in columns:
            columns[name] = np.where(rows, np.nan, columns[name])


def _filled(time: Array, values: Array) -> Array:
    """The values with gaps of a slow sensor on straight lines; longer ones stay gaps."""
    known = np.isfinite(values)
    if known.all() or known.sum() < 2:
        return values
    steps = np.diff(time[known])
    usual = 1.5 * float(np.quantile(steps, 0.9))
    filled = np.interp(time, time[known], values[known], left=np.nan, right=np.nan)
    after = np.clip(np.searchsorted(time[known], time, "left"), 1, int(known.sum()) - 1)
    return np.where(known | (steps[after - 1] <= usual), filled, np.nan)
