"""One sigma of each calibrated column from its calibration: what all samples of a flight have in common."""

from collections.abc import Mapping

import numpy as np
from numpy.typing import NDArray

from daq.contract.constants import GRAVITY
from groundstation.calibration.conversions import curves
from groundstation.calibration.conversions.direct import direct_columns
from groundstation.calibration.schema import CalibrationCurve, CalibrationSet, Instrument

Array = NDArray[np.float64]


def column_uncertainty(calibration: CalibrationSet, columns: Mapping[str, Array]) -> dict[str, float]:
    """One sigma of the calibration of each column at this flight's median reading, as the calibration files state it.

    What the files do not state is not in it; noise is apart (`noise`).
    """
    out: dict[str, float] = {}
    _put(out, "p_dynamic", _curve_sigma(calibration.get("pitot")))
    for direct in direct_columns(calibration):
        _put(out, direct.column.name, _curve_sigma(direct.instrument))
    _controls(calibration, out)
    _air(calibration, columns, out)
    _vanes(calibration, out)
    _triads(calibration, columns, out)
    item = calibration.get("attitude")
    if item and item.attitude and any(item.attitude.uncertainty):
        out.update(zip(("phi", "theta", "psi"), item.attitude.uncertainty, strict=True))
    return {name: sigma for name, sigma in out.items() if name in columns and np.isfinite(columns[name]).any()}


def _put(out: dict[str, float], column: str, sigma: float | None) -> None:
    if sigma:
        out[column] = sigma


def _curve_sigma(item: Instrument | None) -> float | None:
    """Root mean square over the calibrated range: the flight's readings are not at one place of it."""
    if item is None or item.curve is None:
        return None
    return curve_sigma(item.curve)


def curve_sigma(curve: CalibrationCurve) -> float:
    """One sigma of a curve, root mean square over its valid range [output unit]."""
    grid = np.linspace(*curve.valid, 21)
    return float(np.sqrt(np.mean(curves.standard_deviation(curve, grid) ** 2)))


def _controls(calibration: CalibrationSet, out: dict[str, float]) -> None:
    item = calibration.get("mixing")
    if item is None or item.mixing is None:
        return
    weights = {"e": item.mixing.elevator, "a": item.mixing.aileron}
    for prefix, left_name, right_name in (("delta", "elevon_left", "elevon_right"), ("cmd", "pwm_1", "pwm_2")):
        left, right = _curve_sigma(calibration.get(left_name)), _curve_sigma(calibration.get(right_name))
        if left is not None and right is not None:
            for axis, (a, b) in weights.items():
                _put(out, f"{prefix}_{axis}", float(np.hypot(a * left, b * right)))


def _air(calibration: CalibrationSet, columns: Mapping[str, Array], out: dict[str, float]) -> None:
    item = calibration.get("static")
    if item is None or item.static is None:
        return
    pressure, warmth = item.static.uncertainty, item.static.temperature_uncertainty
    _put(out, "p_static", pressure)
    _put(out, "temperature", warmth)
    rho, p, t, q, v = (_median(columns, n) for n in ("rho", "p_static", "temperature", "p_dynamic", "V"))
    if rho is not None and p and t:
        relative = float(np.hypot(pressure / p, warmth / t))
        _put(out, "rho", rho * relative)
        _put(out, "altitude", pressure / (rho * GRAVITY))
        if v and q and q > 0 and "p_dynamic" in out:
            # V = sqrt(2 q / rho): half of each relative error
            _put(out, "V", 0.5 * v * float(np.hypot(out["p_dynamic"] / q, relative)))
            _put(out, "V_cas", 0.5 * v * out["p_dynamic"] / q)


def _vanes(calibration: CalibrationSet, out: dict[str, float]) -> None:
    for column in ("alpha", "beta"):
        item = calibration.get(f"{column}_vane")
        sigma = _curve_sigma(item)
        if item is not None and item.vane is not None and sigma is not None:
            # the wash factor's share is stated at 0.1 rad
            _put(out, column, float(np.hypot(sigma, 0.1 * item.vane.wash_factor_uncertainty) / item.vane.wash_factor))


def _triads(calibration: CalibrationSet, columns: Mapping[str, Array], out: dict[str, float]) -> None:
    names = {"accelerometer": ("ax", "ay", "az"), "gyro": ("p", "q", "r"), "magnetometer": ("mx", "my", "mz")}
    for instrument, axes in names.items():
        item = calibration.get(instrument)
        if item is None or item.triad is None:
            continue
        squares = [float(np.nanmean(columns[a] ** 2)) for a in axes if np.isfinite(columns[a]).any()]
        size = float(np.sqrt(sum(squares)))
        for axis, sigma in zip(axes, item.triad.uncertainty, strict=True):
            _put(out, axis, float(np.hypot(sigma, item.triad.matrix_uncertainty * size)))


def _median(columns: Mapping[str, Array], name: str) -> float | None:
    values = columns[name][np.isfinite(columns[name])]
    return float(np.median(values)) if values.size else None
