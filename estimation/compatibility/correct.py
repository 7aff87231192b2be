"""A flight with its instrument factors taken out."""

from dataclasses import replace

import numpy as np
from scipy.signal import savgol_filter

from estimation.compatibility.records import with_rate_derivatives
from estimation.compatibility.result import Compatibility
from groundstation.flight import Flight


def corrected(flight: Flight, result: Compatibility) -> Flight:
    """Biases and scales removed, late channels moved back, accelerations moved to the centre of gravity.

    Only identifiable factors are applied; those left alone are named in a note.
    """
    value = {n: f.estimate for n, f in result.factors.items() if f.identifiable}
    left = [n for n, f in result.factors.items() if not f.identifiable]
    columns = {c: flight[c].copy() for c in flight.columns}
    for name in ("ax", "ay", "az", "p", "q", "r"):
        columns[name] = columns[name] - value.get(f"d{name}", 0.0)
    for name in ("alpha", "beta", "V"):
        if name in columns:
            columns[name] = (columns[name] - value.get(f"d{name}", 0.0)) / value.get(f"K_{name}", 1.0)
    for name in ("phi", "theta"):
        if name in columns:
            columns[name] = columns[name] - value.get(f"d{name}", 0.0)
    for name in ("alpha", "beta", "V", "phi", "theta", "psi"):
        if f"tau_{name}" in value and name in columns:
            columns[name] = _earlier(flight, columns[name], value[f"tau_{name}"])
    arm = np.array([value.get(f"{axis}_imu", 0.0) for axis in "xyz"])
    if arm.any():
        _move(flight, columns, arm)
    note = f"instrument factors removed: {', '.join(f'{n} {v:+.4g}' for n, v in value.items())}"
    told = [f"not removed because this data cannot tell them: {', '.join(left)}"] if left else []
    detail = {**flight.provenance.detail, "compatibility": {n: float(v) for n, v in value.items()}}
    moved = flight.with_columns(**columns).with_notes(note, *told)
    return replace(moved, provenance=replace(flight.provenance, detail=detail))


def _earlier(flight: Flight, values: np.ndarray, delay: float) -> np.ndarray:
    """The channel as it would stand without its delay; within segments only, NaN where that is beyond the end."""
    result = np.full_like(values, np.nan)
    for part in flight.segments:
        time = flight.time[part]
        known = np.isfinite(values[part])
        if known.sum() >= 2:
            moved = np.interp(time + delay, time[known], values[part][known], left=np.nan, right=np.nan)
            result[part] = np.where(known, moved, np.nan)
    return result


def _move(flight: Flight, columns: dict[str, np.ndarray], arm: np.ndarray) -> None:
    """Specific force from the IMU's place (m from the centre of gravity, body axes) to the centre of gravity."""
    with_rates = with_rate_derivatives(flight, ("p_dot", "q_dot", "r_dot"))
    smooth = {}
    for rate in "pqr":
        smooth[rate] = columns[rate].copy()
        for part in flight.segments:
            if part.stop - part.start >= 5 and np.isfinite(columns[rate][part]).all():
                smooth[rate][part] = savgol_filter(columns[rate][part], 5, 2)
    omega = np.column_stack([smooth[r] for r in "pqr"])
    omega_dot = np.column_stack([with_rates[f"{r}_dot"] for r in "pqr"])
    extra = np.cross(omega_dot, arm) + np.cross(omega, np.cross(omega, arm))
    for i, axis in enumerate("xyz"):
        columns[f"a{axis}"] = columns[f"a{axis}"] - extra[:, i]
