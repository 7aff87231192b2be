"""Calibration files: one TOML per instrument, read into frozen models."""

from datetime import date
from typing import Annotated, Literal

from pydantic import BaseModel, ConfigDict, Field, ValidationError, model_validator

from daq.contract.channels import CHANNEL_BY_NAME, COLUMN_BY_NAME
from daq.utilities.constants import SEA_LEVEL_PRESSURE
from daq.utilities.errors import UserError


class CalibrationError(UserError):
    """A calibration file, set or recording that cannot be used for calibrating."""

    @classmethod
    def of_validation(cls, where: str, error: ValidationError) -> "CalibrationError":
        """The first mistake of a file at `where` with its key, and how many more there are."""
        first = error.errors()[0]
        key = ".".join(str(part) for part in first["loc"])
        message = first["msg"].removeprefix("Value error, ")
        further = f" (and {error.error_count() - 1} more)" if error.error_count() > 1 else ""
        return cls(f"{where}: {key + ': ' if key else ''}{message}{further}")


FORMAT = 1

Finite = Annotated[float, Field(ge=-1e15, le=1e15, allow_inf_nan=False)]
"""A number of a calibration, bounded so that a polynomial of degree five over 24-bit counts (1e36) does not overflow."""
Vector = tuple[Finite, Finite, Finite]
Matrix = tuple[Vector, Vector, Vector]


class _CalibrationTable(BaseModel):
    model_config = ConfigDict(frozen=True, extra="forbid", allow_inf_nan=False)


class CalibrationCurve(_CalibrationTable):
    """Output as a function of one input: a polynomial about `centre`, or a table interpolated linearly.

    valid: range of the input that was calibrated; outside it a value is computed and flagged as extrapolated.
    uncertainty: one sigma of the calibration (not of the noise of a reading) [output unit] within the valid range.
    covariance: of the coefficients, as fitted; gives the uncertainty at each input where present.
    """

    kind: Literal["polynomial", "table"]
    input_unit: str
    output_unit: str
    centre: Finite = 0.0
    coefficients: tuple[Finite, ...] = ()
    inputs: tuple[Finite, ...] = ()
    outputs: tuple[Finite, ...] = ()
    valid: tuple[Finite, Finite]
    uncertainty: Annotated[float, Field(ge=0, allow_inf_nan=False)] = 0.0
    residual_rms: float | None = None
    covariance: tuple[tuple[float, ...], ...] = ()

    @model_validator(mode="after")
    def _consistent(self) -> "CalibrationCurve":
        if self.valid[0] >= self.valid[1]:
            raise ValueError("valid: the lower end must be below the upper end")
        if self.kind == "polynomial" and not self.coefficients:
            raise ValueError("coefficients: a polynomial needs at least one")
        if self.kind == "table":
            if len(self.inputs) < 2 or len(self.inputs) != len(self.outputs):
                raise ValueError("inputs, outputs: a table needs two or more points and as many outputs as inputs")
            if any(a >= b for a, b in zip(self.inputs, self.inputs[1:], strict=False)):
                raise ValueError("inputs: must increase")
        if self.covariance and {len(self.coefficients)} != {len(self.covariance), *map(len, self.covariance)}:
            raise ValueError("covariance: must be square, one row per coefficient")
        return self


class Vane(_CalibrationTable):
    """Where a vane sits and how the aircraft bends the flow there.

    position: from the CG, body axes [m]. local angle = wash_factor * free-stream angle + wash_offset.
    """

    angle: Literal["alpha", "beta"]
    position: Vector
    wash_factor: Annotated[float, Field(gt=0.2, lt=5)] = 1.0
    wash_offset: Finite = 0.0
    wash_factor_uncertainty: Annotated[float, Field(ge=0)] = 0.0


class Triad(_CalibrationTable):
    """Three axes: output = matrix (input - bias - bias_per_kelvin (T - reference_temperature)).

    The input is the count at data-sheet scale, in output units. matrix holds scale and misalignment (for a
    magnetometer the soft iron), bias the zero offset (the hard iron).
    """

    output_unit: str
    matrix: Matrix
    bias: Vector
    bias_per_kelvin: Vector = (0.0, 0.0, 0.0)
    reference_temperature: float = 298.15
    valid: tuple[float, float]
    uncertainty: Vector = (0.0, 0.0, 0.0)
    matrix_uncertainty: Annotated[float, Field(ge=0)] = 0.0
    residual_rms: float | None = None


class Mount(_CalibrationTable):
    """Position of a sensor from the CG, body axes [m]."""

    position: Vector


class Static(_CalibrationTable):
    """Static pressure port: compensation of the chip, position error and reference of the altitude.

    position_error: (measured - true static pressure) / dynamic pressure; feeds_pitot: the differential sensor takes its
    low side from the same port, so that its reading is short by the same amount.
    """

    position_error: Finite = 0.0
    feeds_pitot: bool = True
    pressure_offset: Finite = 0.0
    temperature_offset: Finite = 0.0
    sea_level_pressure: Annotated[float, Field(gt=8e4, lt=1.2e5)] = SEA_LEVEL_PRESSURE
    uncertainty: Annotated[float, Field(ge=0)] = 0.0
    temperature_uncertainty: Annotated[float, Field(ge=0)] = 0.0


class Mixing(_CalibrationTable):
    """delta_e and delta_a as weights of the left and right elevon angles, trailing edge down positive."""

    elevator: tuple[float, float]
    aileron: tuple[float, float]


class MountingAngles(_CalibrationTable):
    """Boresight of the IMU against the body axes (roll, pitch, yaw) and magnetic declination, + east [rad]."""

    boresight: Vector = (0.0, 0.0, 0.0)
    declination: Finite = 0.0
    uncertainty: Vector = (0.0, 0.0, 0.0)


class LoggerFacts(_CalibrationTable):
    """Facts about the logger's sensors, `group.key` = text, for recordings that do not carry them."""

    facts: dict[str, str]


class BenchPoints(_CalibrationTable):
    """The bench points a calibration was fitted from: readings (mean of each dwell) against the reference."""

    reading: tuple[tuple[float, ...], ...] = ()
    reference: tuple[tuple[float, ...], ...] = ()
    samples: tuple[int, ...] = ()


class BenchSource(_CalibrationTable):
    """The recording a calibration was fitted from."""

    recording: str
    sha256: str
    software: str = ""


class Ratiometric(_CalibrationTable):
    """A sensor whose output is a fraction of the 5 V sensor supply: the reading is referred to `reference` volts."""

    reference: Annotated[float, Field(gt=0)]


class SupplySensitivity(_CalibrationTable):
    """Zero shift of a sensor with its supply [output unit per volt] away from `reference` volts."""

    per_volt: Finite
    reference: Annotated[float, Field(gt=0)] = 5.0


class Instrument(_CalibrationTable):
    """One calibration file.

    delay: how far the instrument itself lags the physical quantity [s], by vane dynamics or tubing. The delay of a chip's
    filter is a fact of the recording and is added. column: the flight column that a curve makes, where it is not that of its
    channel, as for a surface known by the pulse that moves it. servo_lag: time constant with which it follows the pulse [s].
    """

    format: Literal[1]
    instrument: str
    kind: Literal["curve", "triad", "static", "mixing", "attitude", "logger", "antenna"]
    date: date
    method: str
    channel: str | None = None
    channels: tuple[str, ...] = ()
    delay: Annotated[float, Field(ge=-0.05, le=1.0)] = 0.0
    note: str = ""
    servo_lag: Annotated[float, Field(ge=0.0, le=0.5)] = 0.0
    column: str | None = None
    curve: CalibrationCurve | None = None
    triad: Triad | None = None
    static: Static | None = None
    mixing: Mixing | None = None
    attitude: MountingAngles | None = None
    logger: LoggerFacts | None = None
    vane: Vane | None = None
    mount: Mount | None = None
    ratiometric: Ratiometric | None = None
    supply_sensitivity: SupplySensitivity | None = None
    points: BenchPoints | None = None
    bench: BenchSource | None = None

    @model_validator(mode="after")
    def _consistent(self) -> "Instrument":
        table = "mount" if self.kind == "antenna" else self.kind
        if getattr(self, table) is None:
            raise ValueError(f"a file of kind {self.kind} needs the table [{table}]")
        unknown = [c for c in (self.channel, *self.channels) if c is not None and c not in CHANNEL_BY_NAME]
        if unknown:
            raise ValueError(f"channel: {unknown[0]} is not in the channel table")
        if self.column is not None and self.column not in COLUMN_BY_NAME:
            raise ValueError(f"column: {self.column} is not a flight column")
        if self.kind == "curve" and self.channel is None:
            raise ValueError("channel: a file of kind curve names the raw channel it reads")
        if self.kind == "triad" and len(self.channels) != 3:
            raise ValueError("channels: a file of kind triad names three raw channels")
        return self
