"""Quality report of a flight: each check has a verdict and a sentence that says what to do.

Nothing here needs a model of the aircraft: time base, repeated and missing values, clipping, spikes, time skew between
channels, noise, and how far the controls were moved. Thresholds are stated beside each check.
"""

from collections.abc import Callable, Iterator
from dataclasses import dataclass
from typing import Literal

import numpy as np
from numpy.typing import NDArray

from daq.contract.channels import COLUMN_BY_NAME
from groundstation.flight.contradictions import contradictions
from groundstation.flight.flight import GAP_FACTOR, Flight
from groundstation.flight.manoeuvres import CONTROLS, find_manoeuvres
from groundstation.flight.notes import NoteKind
from groundstation.flight.quality.noise import noise
from groundstation.flight.quality.plausibility import runs_on, suspicions
from groundstation.flight.quality.repeats import BIG, quantum, repeats, runs_of
from groundstation.flight.quality.skew import Skew, attitude_skew, control_skew

Array = NDArray[np.float64]
Verdict = Literal["ok", "warn", "fail"]

MOVING = ("ax", "ay", "az", "p", "q", "r", "phi", "theta", "psi", "alpha", "beta", "V")
"""Columns that change from sample to sample in flight: a repeated value there is an old value."""

SLOW = ("latitude", "longitude", "altitude_gnss", "vn", "ve", "vd")
"""Columns that carry a value only where there was a fix."""

SENSOR_NOISE = {
    "ax": 0.05, "ay": 0.05, "az": 0.08, "p": 0.007, "q": 0.007, "r": 0.0052, "phi": 0.0052, "theta": 0.0052, "psi": 0.0105,
    "alpha": 0.0052, "beta": 0.0044, "V": 0.15, "delta_e": 0.0012, "delta_a": 0.0012, "delta_r": 0.0012,
}  # fmt: skip
"""Noise of sound sensors of this class [column's unit], one sigma; a flight may carry its own in its provenance."""

ATTITUDE_LATE = 0.025
"""Delay of an attitude behind the gyro [s] worth a warning; slow corrections of its filter look like up to 15 ms."""

COARSE = 0.2
"""Share of samples that equal the one before from which a channel's step is told."""

_DEG = float(np.degrees(1.0))


@dataclass(frozen=True)
class Finding:
    """One check of the quality report: verdict and a sentence for a person."""

    check: str
    verdict: Verdict
    text: str

    def to_json(self) -> dict[str, str]:
        """As in the JSON of `sideslip check`."""
        return {"check": self.check, "verdict": self.verdict, "text": self.text}


def quality_report(flight: Flight) -> tuple[Finding, ...]:
    """All checks of a flight, in a fixed order."""
    checks: tuple[Callable[[Flight], Finding], ...] = (
        time_order, time_gaps, sample_interval, dropouts, stale_samples, clipping, spikes, plausible_values, calibrated_range,
        time_skew, noise_level, excitation,
    )  # fmt: skip
    return (*(check(flight) for check in checks), *contradicting(flight))


def worst(findings: tuple[Finding, ...]) -> Verdict:
    """The worst verdict of a report."""
    verdicts = {f.verdict for f in findings}
    return "fail" if "fail" in verdicts else "warn" if "warn" in verdicts else "ok"


def _finding(check: str, words: list[str], good: str, verdict: Verdict = "warn") -> Finding:
    return Finding(check, verdict if words else "ok", "; ".join(words) if words else good)


# -------------------------------------------------------------------------------------------------------- time base


def time_order(flight: Flight) -> Finding:
    """Rows that were unsorted, repeated or without a time when the file was read."""
    words = [n.text for n in flight.notes if n.kind is NoteKind.TIME_ORDER]
    return _finding("time order", words, "time rises from row to row")


def time_gaps(flight: Flight) -> Finding:
    """Steps in time of more than GAP_FACTOR sample intervals; fail when a tenth of the span is missing."""
    steps = np.diff(flight.time)
    interval = flight.sample_interval
    gaps = np.flatnonzero(steps > GAP_FACTOR * interval)
    if not gaps.size:
        return Finding("time gaps", "ok", f"no gap longer than {GAP_FACTOR * interval:.2g} s")
    missing = float(np.sum(steps[gaps]) - gaps.size * interval)
    part = missing / (flight.time[-1] - flight.time[0])
    longest = gaps[np.argmax(steps[gaps])]
    text = (
        f"{gaps.size} gap{'s' if gaps.size > 1 else ''}, together {missing:.3g} s ({part:.1%}), the longest "
        f"{steps[longest]:.3g} s at t = {flight.time[longest]:.2f} s: the flight is split there and never integrated across"
    )
    return Finding("time gaps", "fail" if part > 0.1 else "warn", text)


def sample_interval(flight: Flight) -> Finding:
    """Single missing samples and jitter: warn beyond 2 % missing or 10 % jitter."""
    steps = np.diff(flight.time)
    interval = flight.sample_interval
    inside = steps[steps <= GAP_FACTOR * interval]
    lost = int(np.sum(np.round(inside / interval) - 1))
    regular = inside[inside < 1.5 * interval]
    jitter = float(np.std(regular)) / interval if regular.size else 0.0
    words = []
    if lost > 0.02 * len(flight):
        words.append(f"{lost} single samples missing ({lost / len(flight):.1%})")
    if jitter > 0.1:
        words.append(f"the sample interval varies by {jitter:.0%}; interpolate to an even one or record its cause")
    good = f"{1 / interval:.2f} Hz, jitter {jitter:.1%}, {lost} single samples missing"
    return _finding("sample interval", words, good)


# ----------------------------------------------------------------------------------------------- values of a channel


def dropouts(flight: Flight) -> Finding:
    """Stretches without a value in columns that are otherwise measured; fail when a third of a moving column is gone.

    Values that begin late or end early (sensors starting up) are told, but are no dropout.
    """
    words: list[str] = []
    verdict: Verdict = "warn"
    outside = 0.0
    for name, values in _measured(flight):
        if name in SLOW:
            continue
        gone = ~np.isfinite(values)
        present = np.flatnonzero(~gone)
        first, last = present[0], present[-1]
        inside = gone[first : last + 1]
        outside = max(outside, float(flight.time[first] - flight.time[0]), float(flight.time[-1] - flight.time[last]))
        count = int(inside.sum())
        if count:
            words.append(
                f"{name} has no value in {count} samples ({inside.mean():.1%}), up to {_longest(inside)} in a row"
            )
        if name in MOVING and float(gone.mean()) > 1 / 3:
            verdict = "fail"
            words.append(f"{name} has no value in {gone.mean():.0%} of the flight")
    good = "every measured column has a value in every row"
    if outside:
        good += f", but for up to {outside:.2f} s at the start or end of the flight"
    return _finding("dropouts", _first(words), good, verdict)


def stale_samples(flight: Flight) -> Finding:
    """Columns slower than their clock, and sensors stuck while the motion must have moved them (see `quality.repeats`).

    Fails when a column that moves in flight never changes. A coarse step in steady flight is no fault, and only told.
    """
    words, coarse = [], []
    verdict: Verdict = "warn"
    for name, values in _measured(flight):
        if name not in MOVING:
            continue
        finite = values[np.isfinite(values)]
        if finite.size < 10:
            continue
        if np.ptp(finite) == 0:
            verdict = "fail"
            words.append(
                f"{name} is {finite[0]:.4g} throughout: no working sensor behind it; leave the column empty where not measured"
            )
            continue
        same = np.diff(finite) == 0
        found = repeats(flight, name)
        rate = (1 - float(same.mean())) / flight.sample_interval
        if found.slow:
            words.append(
                f"{name} repeats {same.mean():.0%} of its samples: new values come at about {rate:.3g} Hz only"
            )
        elif found.stuck.any():
            longest = _longest(found.stuck) * flight.sample_interval
            words.append(
                f"{name} stands still for {longest:.2g} s while it must have moved: stuck sensor or old values"
            )
        elif float(same.mean()) > COARSE:
            coarse.append(f"{name} in steps of {found.quantum:.2g} {_unit(name)}".rstrip())
    good = "no column repeats old values" + (f"; coarse: {', '.join(coarse)}" if coarse else "")
    return _finding("stale samples", _first(words), good, verdict)


def clipping(flight: Flight) -> Finding:
    """Values cut off at the largest or smallest one while they moved: three or more in a row, or flagged by the calibration.

    The flat top of a coarse channel is entered in steps of its quantum, and a control that rests, or holds what was
    commanded, stands still without a stop; a surface is at a stop where its command goes on.
    """
    words = [f"{c}: {n} samples at the end of the sensor's range" for c, n in _detail(flight, "clipped").items()]
    for name, values in _measured(flight):
        if name not in (*MOVING, *CONTROLS):
            continue
        finite = values[np.isfinite(values)]
        if finite.size < 20 or np.ptp(finite) == 0:
            continue
        inner = finite[(finite > finite.min()) & (finite < finite.max())]
        # a coarse or resting channel repeats itself everywhere; a clipped one only at the end of its range
        usual = _longest(np.diff(inner) == 0) + 1
        for extreme, side in ((finite.max(), "largest"), (finite.min(), "smallest")):
            at = finite == extreme
            if _longest(at) >= max(3, 2 * usual + 1) and _cut_off(flight, name, at):
                words.append(
                    f"{name} stays at its {side} value {extreme:.4g} for {int(at.sum())} samples: clipped or at a stop"
                )
    return _finding("clipping", _first(words), "no column stands at an end of its range")


def _cut_off(flight: Flight, name: str, at: NDArray[np.bool_]) -> bool:
    """Whether the longest stay of a column at an end of its range ends its movement. at: of its finite samples."""
    known = np.flatnonzero(np.isfinite(flight[name]))
    values = flight[name][known]
    first, stop = max(runs_of(at), key=lambda run: run[1] - run[0])
    if name in CONTROLS:
        command = f"cmd_{name.removeprefix('delta_')}"
        if not flight.measured(command):
            return False
        asked = flight[command][known[first:stop]]
        return bool(np.nanstd(asked) > BIG * max(quantum(values), noise(flight[name]) or 0.0))
    steps = [abs(values[first] - values[first - 1])] if first else []
    steps += [abs(values[stop - 1] - values[stop])] if stop < values.size else []
    return bool(steps) and max(steps) >= BIG * quantum(values)


def spikes(flight: Flight) -> Finding:
    """Single samples far from both neighbours: more than 10 sigma of the column's own sample-to-sample noise."""
    words = []
    for name, values in _measured(flight):
        if name in MOVING and (found := _spikes(values)).size:
            words.append(
                f"{name}: {found.size} single wild values, the first at t = {flight.time[found[0]]:.2f} s "
                f"({values[found[0]]:.4g}); remove them (NaN) before estimating"
            )
    return _finding("spikes", _first(words), "no single wild values")


def plausible_values(flight: Flight) -> Finding:
    """Values outside what the column can be, and what looks like another unit or sign: a specific force that is not one g,
    an attitude that moves 57 times as far as the gyro turns."""
    found = suspicions(flight.time, flight.columns)
    words = [s.text for s in found]
    suspected = {name for s in found for name in s.columns}
    for name, values in _measured(flight):
        if name in COLUMN_BY_NAME and name not in suspected and not runs_on(flight.time, flight.columns, name):
            low, high = COLUMN_BY_NAME[name].plausible
            outside = int(np.sum((values < low) | (values > high)))
            if outside:
                words.append(f"{name}: {outside} samples outside {low:.4g} to {high:.4g} {COLUMN_BY_NAME[name].unit}")
    return _finding("plausible values", _first(words), "all columns within what they can be", "fail")


def calibrated_range(flight: Flight) -> Finding:
    """Samples for which the calibration was extrapolated; warn beyond 1 %."""
    words = []
    for instrument, count in _detail(flight, "extrapolated").items():
        if count > 0.01 * len(flight):
            words.append(f"{instrument}: {count} samples ({count / len(flight):.1%}) outside the calibrated range")
    return _finding("calibrated range", _first(words), "readings within the calibrated range, or not stated")


# -------------------------------------------------------------------------------------------------- between channels


def time_skew(flight: Flight) -> Finding:
    """Attitude against integrated gyro, measured against commanded surfaces.

    Warns when an attitude lags or leads the gyro by more than ATTITUDE_LATE and three of its bounds, when a surface moves
    before its command, or follows it by more than 0.2 s.
    """
    words, told = [], []
    for skew in attitude_skew(flight):
        told.append(_skew_words(skew))
        if abs(skew.delay) > max(ATTITUDE_LATE, 3 * skew.std):
            words.append(
                f"{skew.late} {'lags' if skew.delay > 0 else 'leads'} {skew.early} by {abs(skew.delay) * 1e3:.0f} ms "
                f"(+-{skew.std * 1e3:.0f}); correct its delay in the calibration file"
            )
    for skew in control_skew(flight):
        told.append(_skew_words(skew))
        if skew.delay < -max(0.01, 3 * skew.std) or skew.delay > 0.2:
            words.append(
                f"{skew.late} follows {skew.early} by {skew.delay * 1e3:.0f} ms (+-{skew.std * 1e3:.0f}), which no servo does"
            )
    return _finding("time skew", words, ", ".join(told) or "not enough motion to tell")


def _skew_words(skew: Skew) -> str:
    return f"{skew.late} after {skew.early} {skew.delay * 1e3:+.0f} ms (+-{skew.std * 1e3:.0f})"


def contradicting(flight: Flight) -> tuple[Finding, ...]:
    """What the flight says twice and differently, one finding each: fail where it moves derivatives. None where nothing does."""
    return tuple(
        Finding("contradictions", "fail" if c.stops else "warn", f"{c.text}{f' (moves {c.moves})' if c.moves else ''}")
        for c in contradictions(flight)
    )


def noise_level(flight: Flight) -> Finding:
    """Sample-to-sample noise against that of the sensor itself; warn beyond four times (vibration, bad contact)."""
    own = {**SENSOR_NOISE, **_detail(flight, "sensor_noise")}
    words, told = [], []
    for name, values in _measured(flight):
        level = noise(values) if name in own else None
        if level is None:
            continue
        told.append(f"{name} {level:.2g}")
        if level > 4 * own[name]:
            words.append(
                f"{name}: noise {level:.2g} {_unit(name)} is {level / own[name]:.0f} times the sensor's own {own[name]:.2g}"
            )
    return _finding(
        "noise", _first(words), "one sigma from sample to sample: " + ", ".join(told) if told else "nothing to judge"
    )


_STILL_DEG = 0.1  # rms of a control that moves less than this tells nothing
_MOVED = 10.0  # rms movement, in noise levels, that counts though it stays within 1 deg


def excitation(flight: Flight) -> Finding:
    """Whether the controls were moved enough, and independently, for their derivatives to be told.

    Warns for a control that stays within 1 deg of trim and moves by less than ten times its noise (a large aeroplane
    answers to half a degree), and for two that move in proportion (correlation beyond 0.9).
    """
    present = [c for c in CONTROLS if flight.measured(c)]
    if not present:
        return Finding("excitation", "warn", "no control surface is measured: no control derivative can be told")
    found = find_manoeuvres(flight)
    words, told = [], []
    for name in present:
        moves = [m for m in found if name in m.controls]
        rms = float(np.nanstd(flight[name])) * _DEG
        told.append(f"{name} {len(moves)} manoeuvres, {rms:.2g} deg rms")
        if not moves and rms < max(_STILL_DEG, _MOVED * _DEG * (noise(flight[name]) or 0.0)):
            words.append(f"{name} is hardly moved ({rms:.2g} deg rms): its derivatives cannot be told from this flight")
    for first, second in ((a, b) for i, a in enumerate(present) for b in present[i + 1 :]):
        both = np.isfinite(flight[first]) & np.isfinite(flight[second])
        if both.sum() > 10 and np.std(flight[first][both]) > 0 and np.std(flight[second][both]) > 0:
            rho = float(np.corrcoef(flight[first][both], flight[second][both])[0, 1])
            if abs(rho) > 0.9:
                words.append(
                    f"{first} and {second} move together (correlation {rho:+.2f}): their derivatives cannot be told apart"
                )
    return _finding("excitation", words, ", ".join(told))


# ------------------------------------------------------------------------------------------------------------ pieces


def _measured(flight: Flight) -> Iterator[tuple[str, Array]]:
    return ((name, values) for name, values in flight.columns.items() if np.isfinite(values).any())


def _detail(flight: Flight, key: str) -> dict[str, float]:
    found = flight.provenance.detail.get(key, {})
    return dict(found) if isinstance(found, dict) else {}


def _unit(name: str) -> str:
    return COLUMN_BY_NAME[name].unit if name in COLUMN_BY_NAME else ""


def _first(words: list[str], most: int = 6) -> list[str]:
    return words if len(words) <= most else [*words[:most], f"{len(words) - most} more"]


def _longest(mask: NDArray[np.bool_]) -> int:
    """Length of the longest run of True."""
    edges = np.flatnonzero(np.diff(np.concatenate([[False], mask, [False]]).astype(np.int8)))
    return int(np.max(edges[1::2] - edges[::2])) if edges.size else 0


def _spikes(values: Array) -> NDArray[np.int64]:
    """Rows whose value is off from both neighbours to the same side by more than 10 sigma of the noise."""
    level = noise(values)
    if not level:
        return np.zeros(0, np.int64)
    before, after = values[1:-1] - values[:-2], values[1:-1] - values[2:]
    scale = max(10 * level, 6 * float(np.nanpercentile(np.abs(np.diff(values)), 95)))
    wild = (before * after > 0) & (np.minimum(np.abs(before), np.abs(after)) > scale)
    return np.asarray(np.flatnonzero(wild) + 1)
