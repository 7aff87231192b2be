"""Fitting calibration files from a bench recording and its plan.

The readings of a dwell are averaged as the calibration will later see them (at data-sheet scale, referred to the sensor
supply where the instrument is ratiometric), so that the fitted file replaces the nominal one as it stands.
"""

from collections.abc import Iterable, Mapping
from dataclasses import dataclass, replace
from datetime import UTC, date, datetime
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from daq.contract.channels import CHANNEL_BY_NAME
from daq.contract.recordings.reading import Recording, read_recording
from groundstation.calibration import conversions, curves
from groundstation.calibration.apply import Calibrator
from groundstation.calibration.bench_plan import BenchPlan, Dwell, InstrumentFit
from groundstation.calibration.calibration_set import CalibrationSet, to_toml
from groundstation.calibration.curves import TriadFit, fit_sphere, fit_vectors
from groundstation.calibration.recording import embedded_calibration, recording_sha256
from groundstation.calibration.scan_table import ScanTable, scan_table
from groundstation.calibration.schema import BenchPoints, BenchSource, CalibrationError, Instrument, Triad

Array = NDArray[np.float64]

_LATEST_UTC_NS = 4_102_444_800_000_000_000  # the year 2100; a recording that claims more does not know its date
_FEWEST_READINGS = 5  # in a dwell, for a mean with a standard deviation
_QUANTISATION = 1 / np.sqrt(12)  # one sigma of rounding to counts [count]
_ROUNDING_SEEN = 0.5  # spread [count] below which noise does not average the rounding out


@dataclass(frozen=True)
class DwellMean:
    """Mean reading of a dwell and one sigma of the mean, (axes,) each; number of readings; IMU temperature [K] or NaN."""

    mean: Array
    std: Array
    samples: int
    temperature: float


@dataclass(frozen=True)
class BenchFit:
    """A fitted calibration file with the sentence a person reads."""

    instrument: Instrument
    text: str


def fit_bench(
    path: str | Path, plan: BenchPlan, base: CalibrationSet | None = None, *, today: date | None = None
) -> tuple[BenchFit, ...]:
    """Fit every instrument of the plan from the recording.

    base: the set whose files are refined (mounting, ratios, delays are taken over); None: the one embedded in the recording.
    Dated by the recording, or `today` where it carries no UTC. Raises CalibrationError with one sentence.
    """
    recording = read_recording(path)
    calibration = base or embedded_calibration(recording)
    bench = BenchSource(recording=Path(path).name, sha256=recording_sha256(recording), software=recording.info.software)
    table = scan_table(recording.scans())
    day = _date(recording, today)
    bench_fits = []
    for fit in plan.fit:
        template = calibration.get(fit.instrument)
        if template is None:
            raise CalibrationError(
                f"{fit.instrument}: not in calibration set {calibration.name}; its file is refined by the bench"
            )
        tables = _InstrumentJob(table, fit, template, calibration, recording.info.details).fitted_tables()
        instrument = template.model_copy(
            update={**tables, "date": day, "method": fit.method or fit.procedure, "bench": bench}
        )
        bench_fits.append(BenchFit(instrument, _summary(instrument, fit)))
    return tuple(bench_fits)


class _InstrumentJob:
    """Fits one instrument of the plan."""

    def __init__(
        self,
        table: ScanTable,
        fit: InstrumentFit,
        template: Instrument,
        calibration: CalibrationSet,
        facts: Mapping[str, str],
    ) -> None:
        self.table = table
        self.fit = fit
        self.template = template
        self.calibrator = Calibrator(calibration, facts)

    def fitted_tables(self) -> dict[str, object]:
        """The tables of the calibration file that the fit replaces, by name."""
        kind = self.template.kind
        if kind == "curve" and self.fit.procedure in ("static_points", "speed_sweep"):
            return self._curve()
        if kind == "triad" and self.fit.procedure in ("vectors", "sphere"):
            return self._triad()
        if kind == "static" and self.fit.procedure == "static_points":
            return self._static()
        raise CalibrationError(
            f"{self.fit.instrument}: procedure {self.fit.procedure} does not fit a file of kind {kind}"
        )

    # --------------------------------------------------------------------------------------------------- one axis

    def _curve(self) -> dict[str, object]:
        template = self.template
        assert template.curve is not None, "a file of kind curve has one"
        assert template.channel is not None, "a file of kind curve names its channel"
        scale, offset = self.calibrator.pressure_transfer(template, template.curve, template.channel)
        reading = self.calibrator.curve_input(template, template.channel, self.table, scale, offset)
        step = scale * (CHANNEL_BY_NAME[template.channel].scale or 1.0)
        dwells = [self._mean(d, [reading], [step]) for d in self.fit.dwell]
        references = np.array([self._reference(d) for d in self.fit.dwell])
        shift = np.zeros(len(dwells))
        if template.supply_sensitivity is not None:
            volts = self.calibrator.sensor_supply(self.table)
            sensitivity = template.supply_sensitivity
            shift = np.array(
                [
                    sensitivity.per_volt * (self._mean(d, [volts], [0.0]).mean[0] - sensitivity.reference)
                    for d in self.fit.dwell
                ]
            )
        curve = curves.fit_polynomial(
            [d.mean[0] for d in dwells],
            references + shift,
            self.fit.degree,
            reading_std=[d.std[0] for d in dwells],
            reference_std=self.fit.reference_uncertainty,
            input_unit=template.curve.input_unit,
            output_unit=template.curve.output_unit,
        )
        # residuals do not show an error common to all references: it stays as a floor
        curve = curve.model_copy(update={"uncertainty": self.fit.systematic_uncertainty})
        points = BenchPoints(
            reading=tuple((float(d.mean[0]),) for d in dwells),
            reference=tuple((float(r),) for r in references),
            samples=tuple(d.samples for d in dwells),
        )
        return {"curve": curve, "points": points}

    def _reference(self, dwell: Dwell) -> float:
        assert isinstance(dwell.reference, float), "checked by the plan"
        if self.fit.reference_unit == "output":
            return dwell.reference
        columns, _ = self.calibrator.columns(self._part(dwell), aligned=False)
        static, temperature = float(np.nanmean(columns["p_static"])), float(np.nanmean(columns["temperature"]))
        if not np.isfinite(static + temperature):
            raise CalibrationError(
                f"{self.fit.instrument}: a reference in m/s needs static pressure and temperature in the recording"
            )
        return conversions.impact_pressure(dwell.reference, static, temperature)

    def _static(self) -> dict[str, object]:
        assert self.template.static is not None, "a file of kind static has one"
        values, _ = self.calibrator.columns(self.table, aligned=False)
        # without wind the columns are the compensated readings with the offset of the file
        dwells = [self._mean(d, [values["p_static"]], [0.0]) for d in self.fit.dwell]
        error = np.array([self._reference(d) for d in self.fit.dwell]) - np.array([d.mean[0] for d in dwells])
        spread = float(np.std(error, ddof=1)) if error.size > 1 else 0.0
        sigma = np.hypot(
            max(spread, self.fit.reference_uncertainty) / np.sqrt(error.size), self.fit.systematic_uncertainty
        )
        static = self.template.static.model_copy(
            update={
                "pressure_offset": self.template.static.pressure_offset + float(error.mean()),
                "uncertainty": float(sigma),
            }
        )
        return {"static": static}

    # ------------------------------------------------------------------------------------------------- three axes

    def _triad(self) -> dict[str, object]:
        old = self.template.triad
        assert old is not None, "a file of kind triad has one"
        axes = [self.calibrator.physical(self.table, c) for c in self.template.channels]
        steps = [CHANNEL_BY_NAME[c].scale or 1.0 for c in self.template.channels]
        if self.fit.procedure == "sphere":
            triad, points = self._sphere(axes), None
        else:
            dwells = [self._mean(d, axes, steps) for d in self.fit.dwell]
            references = np.array([d.reference for d in self.fit.dwell], float)
            readings = np.array([d.mean for d in dwells])
            warming = np.array([d.temperature for d in dwells]) - old.reference_temperature
            if self.fit.fit_temperature and not np.all(np.isfinite(warming)):
                raise CalibrationError(
                    f"{self.fit.instrument}: fit_temperature needs the IMU temperature in each dwell"
                )
            if not self.fit.fit_temperature:
                slope = np.array(old.bias_per_kelvin)
                readings = readings - (np.outer(warming, slope) if slope.any() else 0.0)
            triad = fit_vectors(
                readings,
                references,
                np.array([d.std for d in dwells]),
                self.fit.reference_uncertainty,
                warming if self.fit.fit_temperature else None,
            )
            points = BenchPoints(
                reading=tuple(tuple(d.mean.tolist()) for d in dwells),
                reference=tuple(tuple(r) for r in references.tolist()),
                samples=tuple(d.samples for d in dwells),
            )
        return {"triad": self._updated(old, triad), "points": points}

    def _sphere(self, axes: list[Array]) -> TriadFit:
        selected = np.zeros(len(self.table), bool)
        for dwell in self.fit.dwell:
            selected |= self._rows(dwell)
        readings = np.stack(axes, axis=1)[selected]
        readings = readings[np.isfinite(readings).all(axis=1)]
        assert self.fit.field is not None, "checked by the plan"
        return fit_sphere(readings, self.fit.field, self.fit.reference_uncertainty)

    def _updated(self, old: Triad, fit: TriadFit) -> Triad:
        slope = tuple(fit.bias_per_kelvin.tolist()) if self.fit.fit_temperature else old.bias_per_kelvin
        common = self.fit.systematic_uncertainty
        return old.model_copy(
            update={
                "matrix": tuple(tuple(row) for row in fit.matrix.tolist()),
                "bias": tuple(fit.bias.tolist()),
                "bias_per_kelvin": slope,
                "uncertainty": tuple(np.hypot(fit.bias_std, common).tolist()),
                "matrix_uncertainty": float(fit.matrix_std.max()),
                "residual_rms": fit.residual_rms,
            }
        )

    # ------------------------------------------------------------------------------------------------------ dwells

    def _rows(self, dwell: Dwell) -> NDArray[np.bool_]:
        time = self.table.time - self.table.time[0]
        return np.asarray((time >= dwell.start) & (time <= dwell.stop))

    def _part(self, dwell: Dwell) -> ScanTable:
        rows = self._rows(dwell)
        if not rows.any():
            raise CalibrationError(
                f"{self.fit.instrument}: the recording has no scans between {dwell.start:g} and {dwell.stop:g} s"
            )
        return self.table.part(rows)

    def _mean(self, dwell: Dwell, axes: Iterable[Array], steps: Iterable[float]) -> DwellMean:
        rows = self._rows(dwell)
        means, stds, fewest = [], [], len(self.table)
        for axis, step in zip(axes, steps, strict=True):
            values = axis[rows]
            values = values[np.isfinite(values)]
            if values.size < _FEWEST_READINGS:
                raise CalibrationError(
                    f"{self.fit.instrument}: only {values.size} readings between {dwell.start:g} and {dwell.stop:g} s; "
                    f"at least {_FEWEST_READINGS} are needed"
                )
            spread = float(np.std(values, ddof=1))
            quantum = abs(step) * _QUANTISATION if spread < _ROUNDING_SEEN * abs(step) else 0.0
            means.append(float(np.mean(values)))
            stds.append(float(np.hypot(spread / np.sqrt(values.size), quantum)))
            fewest = min(fewest, values.size)
        temperatures = self.calibrator.physical(self.table, "imu_temperature")[rows]
        temperatures = temperatures[np.isfinite(temperatures)]
        temperature = float(np.mean(temperatures)) if temperatures.size else float("nan")
        return DwellMean(np.array(means), np.array(stds), fewest, temperature)


def fitted_set(base: CalibrationSet, fits: Iterable[BenchFit]) -> CalibrationSet:
    """The base set with the fitted files replaced."""
    texts = {f"{f.instrument.instrument}.toml": to_toml(f.instrument) for f in fits}
    return replace(base.with_texts(texts), name=base.name)


def _summary(instrument: Instrument, fit: InstrumentFit) -> str:
    curve, triad, static = instrument.curve, instrument.triad, instrument.static
    start = f"{instrument.instrument}: {len(fit.dwell)} {'points' if triad is None else 'dwells'}"
    if curve is not None:
        low, high = curve.valid
        largest = float(np.max(curves.sigma_over_range(curve)))
        return (
            f"{start}, degree {fit.degree}, residual {curve.residual_rms:.3g} {curve.output_unit} rms, one sigma at most "
            f"{largest:.3g} {curve.output_unit} from {low:.6g} to {high:.6g} {curve.input_unit}"
        )
    if triad is not None:
        bias, sigma = (", ".join(f"{v:.4g}" for v in values) for values in (triad.bias, triad.uncertainty))
        return (
            f"{start}, residual {triad.residual_rms:.3g} {triad.output_unit} rms, bias {bias} (+- {sigma}), "
            f"scale and misalignment +- {triad.matrix_uncertainty:.2g}"
        )
    if static is not None:
        return f"{start}, offset {static.pressure_offset:.4g} Pa (+- {static.uncertainty:.3g})"
    return start


def _date(recording: Recording, today: date | None) -> date:
    """The date of a recording, or `today` where it carries none. Raises CalibrationError without either."""
    started = recording.info.started_utc_ns
    if 0 < started <= _LATEST_UTC_NS:
        return datetime.fromtimestamp(started * 1e-9, UTC).date()
    if today is None:
        raise CalibrationError(f"{recording.path}: the recording carries no date; give one with --date")
    return today
