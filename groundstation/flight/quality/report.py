"""Quality report of a flight: each check is one finding, with a severity and a sentence on what to do.

No check needs a model of the aircraft: time base, missing and repeated values, clipping, spikes, time skew between channels,
noise, contradictions, and how far the controls were moved.
"""

from collections.abc import Callable, Iterator, Sequence
from itertools import combinations

import numpy as np
from numpy.typing import NDArray

from daq.contract.channels import COLUMN_BY_NAME
from daq.utilities.constants import RADIAN
from groundstation.flight.arrays import Array, Mask, longest_run, true_runs
from groundstation.flight.contradictions import Contradiction, contradictions
from groundstation.flight.findings import Finding, FindingKind, Severity
from groundstation.flight.flight import GAP_FACTOR, Flight
from groundstation.flight.manoeuvres import CONTROLS, find_manoeuvres
from groundstation.flight.quality.noise import noise
from groundstation.flight.quality.plausibility import is_unwrapped, suspicions
from groundstation.flight.quality.repeats import BIG, MOVING, quantum, repeats
from groundstation.flight.quality.skew import Skew, attitude_skew, control_skew

FIX_COLUMNS = ("latitude", "longitude", "altitude_gnss", "vn", "ve", "vd")
"""Columns with a value only at each fix of a receiver."""

SENSOR_NOISE = {
    **dict.fromkeys(("ax", "ay"), 0.05), "az": 0.08, **dict.fromkeys(("p", "q"), 0.007), "r": 0.0052,
    **dict.fromkeys(("phi", "theta", "alpha"), 0.0052), "psi": 0.0105, "beta": 0.0044, "V": 0.15,
    **dict.fromkeys(CONTROLS, 0.0012),
}  # fmt: skip
"""Noise of sound sensors of this class [column's unit], one sigma; a flight's provenance may state that of its sensors."""

ATTITUDE_LATE = 0.025
"""Delay of an attitude behind the gyro [s] that is warned of; slow corrections of its filter look like up to 15 ms."""
SERVO_DELAY = (-0.01, 0.2)  # [s] of a surface behind its command that a servo can have, less the error of the estimate
COARSE_SHARE = 0.2  # of samples that equal the one before, from which a channel's step is reported
MOST_SENTENCES = 6  # of one check; the number of further ones follows
LEAST_RMS_DEG = 0.1  # of a control, below which its derivatives cannot be identified
LEAST_RMS_OVER_NOISE = 10.0  # movement that suffices although it stays within 1 deg
MOST_CORRELATION = 0.9  # of two controls, beyond which their derivatives cannot be separated
LARGEST_MISSING = 0.1  # of the time span, beyond which gaps make the check fail
LARGEST_EXTRAPOLATED = 0.01  # of the samples, beyond which an extrapolated calibration is warned of
SINGLE_MISSING, LARGEST_JITTER = 0.02, 0.1  # of the samples, and of the sample interval, that are warned of
SPIKE_SIGMAS = 10  # of a channel's noise, from both neighbours
SPIKE_STEPS = 6  # times the 0.95 quantile of the steps, too: edges of manoeuvres are no spikes
SKEW_SIGMAS = 3  # of a delay that is warned of
SHORTEST_CLIP = 3  # samples in a row at the end of a range
FEWEST_VALUES = 10  # of a column that is judged
LARGEST_DROPOUT = 1 / 3  # of a column without a value, beyond which the check fails
LARGEST_STATED = 1e12  # number of a provenance that is used: no count or noise is as large
NOISE_RATIO = 4  # of measured over sensor noise, from which vibration or a bad contact is likely


def quality_report(flight: Flight, contradicted: Sequence[Contradiction] | None = None) -> tuple[Finding, ...]:
    """All checks of a flight, in a fixed order. contradicted: result of `contradictions`, if known."""
    checks: tuple[Callable[[Flight], Finding], ...] = (
        *(time_order, time_gaps, sample_interval, dropouts, stale_samples, clipping, spikes, plausible_values),
        *(calibrated_range, time_skew, noise_level, excitation),
    )
    contradicted = contradictions(flight) if contradicted is None else contradicted
    return (*(check(flight) for check in checks), *contradiction_findings(contradicted))


def _finding(check: str, sentences: Sequence[str], summary: str, severity: Severity = "warn") -> Finding:
    """The finding of a check: its sentences with a severity, or `summary` with severity "ok" where there are none."""
    return Finding(check, "; ".join(sentences), severity) if sentences else Finding(check, summary, "ok")


# -------------------------------------------------------------------------------------------------------- time base


def time_order(flight: Flight) -> Finding:
    """Rows that were unsorted, repeated or without a time when the file was read."""
    sentences = [n.text for n in flight.notes if n.kind == FindingKind.TIME_ORDER]
    return _finding("time order", sentences, "time rises from row to row")


def time_gaps(flight: Flight) -> Finding:
    """Steps in time of more than GAP_FACTOR sample intervals; fail beyond LARGEST_MISSING of the span."""
    steps = np.diff(flight.time)
    interval = flight.sample_interval
    gaps = np.flatnonzero(steps > GAP_FACTOR * interval)
    if not gaps.size:
        return Finding("time gaps", f"no gap longer than {GAP_FACTOR * interval:.2g} s", "ok")
    missing = float(np.sum(steps[gaps]) - gaps.size * interval)
    share = missing / (flight.time[-1] - flight.time[0])
    longest = gaps[np.argmax(steps[gaps])]
    text = (
        f"{gaps.size} gap{'s' if gaps.size > 1 else ''}, together {missing:.3g} s ({share:.1%}), the longest "
        f"{steps[longest]:.3g} s at t = {flight.time[longest]:.2f} s: the flight is split there and never integrated across"
    )
    return Finding("time gaps", text, "fail" if share > LARGEST_MISSING else "warn")


def sample_interval(flight: Flight) -> Finding:
    """Single missing samples, and jitter of the sample interval."""
    steps = np.diff(flight.time)
    interval = flight.sample_interval
    steps = steps[steps <= GAP_FACTOR * interval]
    missing = int(np.sum(np.round(steps / interval) - 1))
    regular = steps[steps < 1.5 * interval]  # without missing samples between
    jitter = float(np.std(regular)) / interval if regular.size else 0.0
    sentences = []
    if missing > SINGLE_MISSING * len(flight):
        sentences.append(f"{missing} single samples missing ({missing / len(flight):.1%})")
    if jitter > LARGEST_JITTER:
        sentences.append(f"the sample interval varies by {jitter:.0%}; interpolate to an even one or record its cause")
    summary = f"{1 / interval:.2f} Hz, jitter {jitter:.1%}, {missing} single samples missing"
    return _finding("sample interval", sentences, summary)


# ----------------------------------------------------------------------------------------------- values of a channel


def dropouts(flight: Flight) -> Finding:
    """Stretches without a value in measured columns; fail where a third of a column of `MOVING` is missing.

    Values that begin late or end early (sensors starting up) are reported, but are not dropouts.
    """
    sentences: list[str] = []
    severity: Severity = "warn"
    outside = 0.0
    for name, values in _measured(flight):
        if name in FIX_COLUMNS:
            continue
        missing = ~np.isfinite(values)
        first, last = np.flatnonzero(~missing)[[0, -1]]
        holes = missing[first : last + 1]
        outside = max(outside, float(flight.time[first] - flight.time[0]), float(flight.time[-1] - flight.time[last]))
        if holes.any():
            extent = f"{int(holes.sum())} samples ({holes.mean():.1%}), up to {longest_run(holes)} in a row"
            sentences.append(f"{name} has no value in {extent}")
        if name in MOVING and float(missing.mean()) > LARGEST_DROPOUT:
            severity = "fail"
            sentences.append(f"{name} has no value in {missing.mean():.0%} of the flight")
    summary = "every measured column has a value in every row"
    if outside:
        summary += f", but for up to {outside:.2f} s at the start or end of the flight"
    return _finding("dropouts", _shortened(sentences), summary, severity)


def stale_samples(flight: Flight) -> Finding:
    """Columns slower than the samples, and sensors stuck while the motion must have moved them (see `quality.repeats`).

    Fail where a column of `MOVING` never changes. A coarse step is reported without a warning.
    """
    sentences, coarse = [], []
    severity: Severity = "warn"
    for name, values in _measured(flight):
        finite = values[np.isfinite(values)]
        if name not in MOVING or finite.size < FEWEST_VALUES:
            continue
        if np.ptp(finite) == 0:
            severity = "fail"
            sentences.append(
                f"{name} is {finite[0]:.4g} throughout: no working sensor behind it; leave the column empty where not measured"
            )
            continue
        repeat_share = float((np.diff(finite) == 0).mean())
        repeated = repeats(flight, name)
        if repeated.slow:
            rate = (1 - repeat_share) / flight.sample_interval
            sentences.append(
                f"{name} repeats {repeat_share:.0%} of its samples: new values come at about {rate:.3g} Hz only"
            )
        elif repeated.stuck.any():
            longest = longest_run(repeated.stuck) * flight.sample_interval
            sentences.append(
                f"{name} stands still for {longest:.2g} s while it must have moved: stuck sensor or old values"
            )
        elif repeat_share > COARSE_SHARE:
            coarse.append(f"{name} in steps of {repeated.quantum:.2g} {_unit(name)}".rstrip())
    summary = "no column repeats old values" + (f"; coarse: {', '.join(coarse)}" if coarse else "")
    return _finding("stale samples", _shortened(sentences), summary, severity)


def clipping(flight: Flight) -> Finding:
    """Values cut off at the largest or smallest one while they moved: at least three in a row, or reported by the calibration.

    A coarse channel reaches a flat top in steps of its quantum and is not clipped. A surface is at a stop only where its command
    moves on.
    """
    clipped = _counts(flight, "clipped")
    sentences = [f"{c}: {n} samples at the end of the sensor's range" for c, n in clipped.items()]
    for name, values in _measured(flight):
        finite = values[np.isfinite(values)]
        if name not in (*MOVING, *CONTROLS) or finite.size < 2 * FEWEST_VALUES or np.ptp(finite) == 0:
            continue
        inner = finite[(finite > finite.min()) & (finite < finite.max())]
        # a coarse or resting channel repeats values everywhere, a clipped one at the end of its range only
        typical = longest_run(np.diff(inner) == 0) + 1
        for extreme, side in ((finite.max(), "largest"), (finite.min(), "smallest")):
            at_end = finite == extreme
            if longest_run(at_end) >= max(SHORTEST_CLIP, 2 * typical + 1) and _cut_off(flight, name, at_end):
                count = int(at_end.sum())
                sentences.append(
                    f"{name} stays at its {side} value {extreme:.4g} for {count} samples: clipped or at a stop"
                )
    return _finding("clipping", _shortened(sentences), "no column stands at an end of its range")


def _cut_off(flight: Flight, name: str, at_end: Mask) -> bool:
    """Whether a column's longest run at an end of its range cuts off a movement. at_end: (n,), of its finite samples."""
    rows = np.flatnonzero(np.isfinite(flight[name]))
    values = flight[name][rows]
    first, stop = max(true_runs(at_end), key=lambda run: run[1] - run[0])
    if name in CONTROLS:
        command = f"cmd_{name.removeprefix('delta_')}"
        if not flight.measured(command):
            return False
        commanded = flight[command][rows[first:stop]]
        return bool(np.nanstd(commanded) > BIG * max(quantum(values), noise(flight[name]) or 0.0))
    steps = [abs(values[first] - values[first - 1])] if first else []
    steps += [abs(values[stop - 1] - values[stop])] if stop < values.size else []
    return bool(steps) and max(steps) >= BIG * quantum(values)


def spikes(flight: Flight) -> Finding:
    """Single samples further than SPIKE_SIGMAS of the column's noise from both neighbours."""
    sentences = []
    for name, values in _measured(flight):
        if name in MOVING and (rows := _spikes(values)).size:
            sentences.append(
                f"{name}: {rows.size} single wild values, the first at t = {flight.time[rows[0]]:.2f} s "
                f"({values[rows[0]]:.4g}); remove them (NaN) before estimating"
            )
    return _finding("spikes", _shortened(sentences), "no single wild values")


def _spikes(values: Array) -> NDArray[np.int64]:
    """Rows whose value is beyond both neighbours, to the same side, by more than SPIKE_SIGMAS and the usual change of a step."""
    level = noise(values)
    if not level:
        return np.zeros(0, np.int64)
    rise, fall = values[1:-1] - values[:-2], values[1:-1] - values[2:]
    scale = max(SPIKE_SIGMAS * level, SPIKE_STEPS * float(np.nanpercentile(np.abs(np.diff(values)), 95)))
    wild = (rise * fall > 0) & (np.minimum(np.abs(rise), np.abs(fall)) > scale)
    return np.asarray(np.flatnonzero(wild) + 1)


def plausible_values(flight: Flight) -> Finding:
    """Values outside a column's plausible range, and those that look like another unit, sign or axis (`quality.plausibility`)."""
    suspected = suspicions(flight.time, flight.columns)
    sentences = [s.text for s in suspected]
    names = {name for s in suspected for name in s.columns}
    for name, values in _measured(flight):
        if name in COLUMN_BY_NAME and name not in names and not is_unwrapped(flight.time, flight.columns, name):
            low, high = COLUMN_BY_NAME[name].plausible
            outside = int(np.sum((values < low) | (values > high)))
            if outside:
                sentences.append(f"{name}: {outside} samples outside {low:.4g} to {high:.4g} {_unit(name)}")
    return _finding("plausible values", _shortened(sentences), "all columns within what they can be", "fail")


def calibrated_range(flight: Flight) -> Finding:
    """Samples for which the calibration was extrapolated."""
    sentences = [
        f"{instrument}: {count} samples ({count / len(flight):.1%}) outside the calibrated range"
        for instrument, count in _counts(flight, "extrapolated").items()
        if count > LARGEST_EXTRAPOLATED * len(flight)
    ]
    return _finding("calibrated range", _shortened(sentences), "readings within the calibrated range, or not stated")


# -------------------------------------------------------------------------------------------------- between channels


def time_skew(flight: Flight) -> Finding:
    """Delay of attitude behind the integrated gyros, and of surfaces behind their commands.

    Warn where an attitude lags or leads the gyro by more than ATTITUDE_LATE and three standard deviations, or the delay of a
    surface is outside SERVO_DELAY, and before its command by more than two.
    """
    sentences = []
    attitudes, surfaces = attitude_skew(flight), control_skew(flight)
    for skew in attitudes:
        if abs(skew.delay) > max(ATTITUDE_LATE, SKEW_SIGMAS * skew.std):
            sentences.append(
                f"{skew.late} {'lags' if skew.delay > 0 else 'leads'} {skew.early} by {abs(skew.delay) * 1e3:.0f} ms "
                f"(+-{skew.std * 1e3:.0f}); correct its delay in the calibration file"
            )
    for skew in surfaces:
        if skew.delay < min(SERVO_DELAY[0], -2 * skew.std) or skew.delay > SERVO_DELAY[1]:
            sentences.append(
                f"{skew.late} follows {skew.early} by {skew.delay * 1e3:.0f} ms (+-{skew.std * 1e3:.0f}), which no servo does"
            )
    summary = ", ".join(map(_skew_words, (*attitudes, *surfaces))) or "not enough motion to tell"
    return _finding("time skew", sentences, summary)


def _skew_words(skew: Skew) -> str:
    return f"{skew.late} after {skew.early} {skew.delay * 1e3:+.0f} ms (+-{skew.std * 1e3:.0f})"


def contradiction_findings(contradicted: Sequence[Contradiction]) -> tuple[Finding, ...]:
    """One finding for each contradiction; fail where no estimate is recommended because of it."""
    return tuple(
        Finding("contradictions", f"{c.text}{f' (moves {c.moves})' if c.moves else ''}", "fail" if c.stops else "warn")
        for c in contradicted
    )


def noise_level(flight: Flight) -> Finding:
    """White noise of each column against that of its sensor."""
    sensor_noise = {**SENSOR_NOISE, **_counts(flight, "sensor_noise")}
    sentences, levels = [], []
    for name, values in _measured(flight):
        level = noise(values) if name in sensor_noise else None
        if level is None:
            continue
        levels.append(f"{name} {level:.2g}")
        sensor = sensor_noise[name]
        if level > NOISE_RATIO * sensor:
            times = f"{level / sensor:.0f} times the sensor's own {sensor:.2g}"
            sentences.append(f"{name}: noise {level:.2g} {_unit(name)} is {times}")
    summary = "one sigma from sample to sample: " + ", ".join(levels) if levels else "nothing to judge"
    return _finding("noise", _shortened(sentences), summary)


def excitation(flight: Flight) -> Finding:
    """Whether the controls were moved enough, and independently, to identify their derivatives.

    Warn for a control without a manoeuvre whose rms is below LEAST_RMS_DEG or LEAST_RMS_OVER_NOISE (a large aeroplane responds to
    half a degree), and for two that move in proportion.
    """
    controls = [c for c in CONTROLS if flight.measured(c)]
    if not controls:
        return Finding("excitation", "no control surface is measured: no control derivative can be told", "warn")
    manoeuvres = find_manoeuvres(flight)
    sentences, movements = [], []
    for name in controls:
        count = sum(name in m.controls for m in manoeuvres)
        rms = float(np.nanstd(flight[name])) * RADIAN
        movements.append(f"{name} {count} manoeuvres, {rms:.2g} deg rms")
        if not count and rms < max(LEAST_RMS_DEG, LEAST_RMS_OVER_NOISE * RADIAN * (noise(flight[name]) or 0.0)):
            sentences.append(
                f"{name} is hardly moved ({rms:.2g} deg rms): its derivatives cannot be told from this flight"
            )
    for first, second in combinations(controls, 2):
        rows = np.isfinite(flight[first]) & np.isfinite(flight[second])
        if rows.sum() > FEWEST_VALUES and np.std(flight[first][rows]) > 0 and np.std(flight[second][rows]) > 0:
            rho = float(np.corrcoef(flight[first][rows], flight[second][rows])[0, 1])
            if abs(rho) > MOST_CORRELATION:
                sentences.append(
                    f"{first} and {second} move together (correlation {rho:+.2f}): their derivatives cannot be told apart"
                )
    return _finding("excitation", sentences, ", ".join(movements))


# ----------------------------------------------------------------------------------------------------------- helpers


def _measured(flight: Flight) -> Iterator[tuple[str, Array]]:
    """Name and values (N,) of the columns with at least one value."""
    return ((name, values) for name, values in flight.columns.items() if np.isfinite(values).any())


def _counts(flight: Flight, key: str) -> dict[str, float]:
    """Positive numbers by instrument or column under a key of the provenance's detail, as the calibration states them."""
    counts = flight.provenance.detail.get(key, {})
    entries = counts.items() if isinstance(counts, dict) else ()
    return {n: v for n, v in entries if isinstance(v, int | float) and 0 < v < LARGEST_STATED}


def _unit(name: str) -> str:
    return COLUMN_BY_NAME[name].unit if name in COLUMN_BY_NAME else ""


def _shortened(sentences: list[str]) -> list[str]:
    """The first MOST_SENTENCES, and how many more there are."""
    excess = len(sentences) - MOST_SENTENCES
    return sentences if excess <= 0 else [*sentences[:MOST_SENTENCES], f"{excess} more"]
