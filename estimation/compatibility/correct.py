"""A flight with its instrument factors removed: estimated ones and given ones."""

from dataclasses import replace

import numpy as np

from estimation.compatibility.reconstruction import Compatibility
from estimation.compatibility.records import PARABOLA, with_rate_derivatives
from estimation.structure.odd_flights import CORRECTION_BOUNDS
from groundstation.flight import Flight


def correct_flight(flight: Flight, result: Compatibility) -> Flight:
    """The flight with biases and scales removed, delays undone, accelerations and flow angles moved to the centre of gravity.

    Given factors and identifiable estimated ones are applied. A warning names those that are not, because they are not
    identifiable or need a channel that was not measured.
    """
    value = {**result.known, **{n: f.estimate for n, f in result.factors.items() if f.identifiable}}
    unidentifiable = [n for n, f in result.factors.items() if not f.identifiable]
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
    arm, vane = (np.array([value.get(f"{axis}_{place}", 0.0) for axis in "xyz"]) for place in ("imu", "vane"))
    if arm.any():
        _move(flight, columns, arm)
    if vane.any() and not _move_vanes(flight, columns, vane):
        unidentifiable += [n for n in value if n.endswith("_vane")]
        value = {n: v for n, v in value.items() if not n.endswith("_vane")}
    note = f"instrument factors removed: {', '.join(f'{n} {v:+.4g}' for n, v in value.items())}"
    warnings = (
        [f"not removed because this data cannot tell or use them: {', '.join(unidentifiable)}"]
        if unidentifiable
        else []
    )
    bounds = {n: float(f.std_coloured) for n, f in result.factors.items() if n in value and np.isfinite(f.std_coloured)}
    detail = {
        **flight.provenance.detail, "compatibility": {n: float(v) for n, v in value.items()}, CORRECTION_BOUNDS: bounds
    }  # fmt: skip
    result_flight = flight.with_columns(**columns).with_notes(note, *warnings)
    return replace(result_flight, provenance=replace(flight.provenance, detail=detail))


def _earlier(flight: Flight, values: np.ndarray, delay: float) -> np.ndarray:
    """The channel without its delay [s], segment by segment; NaN at the end, where the samples are missing."""
    result = np.full_like(values, np.nan)
    for part in flight.segments:
        time = flight.time[part]
        measured = np.isfinite(values[part])
        if measured.sum() >= 2:
            shifted = np.interp(time + delay, time[measured], values[part][measured], left=np.nan, right=np.nan)
            result[part] = np.where(measured, shifted, np.nan)
    return result


def _move(flight: Flight, columns: dict[str, np.ndarray], arm: np.ndarray) -> None:
    """Move the specific force in `columns` from the IMU to the centre of gravity. arm: IMU from there, body axes [m]."""
    with_rates = with_rate_derivatives(flight, ("p_dot", "q_dot", "r_dot"))
    omega = _smooth_rates(flight, columns)
    omega_dot = np.column_stack([with_rates[f"{r}_dot"] for r in "pqr"])
    due_to_arm = np.cross(omega_dot, arm) + np.cross(omega, np.cross(omega, arm))
    for i, axis in enumerate("xyz"):
        columns[f"a{axis}"] = columns[f"a{axis}"] - due_to_arm[:, i]


def _smooth_rates(flight: Flight, columns: dict[str, np.ndarray]) -> np.ndarray:
    """(N, 3) p, q, r [rad/s] by local parabolas through 5 samples."""
    from scipy.signal import savgol_filter

    smooth = {}
    for rate in "pqr":
        smooth[rate] = columns[rate].copy()
        for part in flight.segments:
            if part.stop - part.start >= PARABOLA[0] and np.isfinite(columns[rate][part]).all():
                smooth[rate][part] = savgol_filter(columns[rate][part], *PARABOLA)
    return np.column_stack([smooth[r] for r in "pqr"])


def _move_vanes(flight: Flight, columns: dict[str, np.ndarray], arm: np.ndarray) -> bool:
    """Move the flow angles in `columns` from the vanes to the centre of gravity; False without V. arm: vanes from there [m].

    The velocity through the air at the vane is s d with d = (cos a cos b, sin b, sin a cos b) and the speed s that gives V at the
    centre of gravity: |s d - omega x arm| = V, as in the kinematic model. An angle that was not measured counts as zero in d.
    """
    if "V" not in columns or not flight.measured("V"):
        return False
    zeros = np.zeros(len(flight))
    alpha, beta = (columns.get(n, zeros) if flight.measured(n) else zeros for n in ("alpha", "beta"))
    d = np.column_stack([np.cos(alpha) * np.cos(beta), np.sin(beta), np.sin(alpha) * np.cos(beta)])
    turn = np.cross(_smooth_rates(flight, columns), arm)
    projection = np.sum(d * turn, axis=1)
    with np.errstate(invalid="ignore"):
        speed = projection + np.sqrt(projection**2 - np.sum(turn**2, axis=1) + columns["V"] ** 2)
        u, v, w = (speed[:, None] * d - turn).T
    angles = {"alpha": np.arctan2(w, u), "beta": np.arctan2(v, np.hypot(u, w))}
    for name, values in angles.items():
        if flight.measured(name):
            columns[name] = np.where(np.isfinite(columns[name]), values, np.nan)
    return True
