"""The bench plan: what was set on the bench while a recording ran, so that curves can be fitted from it.

format = 1
[[fit]]
instrument = "beta_vane"
procedure = "static_points"        # static_points, speed_sweep, vectors (six faces, turntable) or sphere (magnetometer)
method = "protractor, 13 positions"
degree = 1
reference_uncertainty = 0.0009     # one sigma of a reference, independent from dwell to dwell, output unit
systematic_uncertainty = 0.0005    # one sigma of what all references have in common
[[fit.dwell]]
start = 2.0                        # s after the first scan of the recording
stop = 5.0
reference = -0.35                  # output unit; [x, y, z] in body axes for vectors; m/s with reference_unit = "m/s"
"""

from pathlib import Path
from typing import Annotated, Literal

from pydantic import BaseModel, ConfigDict, Field, ValidationError, model_validator

from daq.utilities.input_files import parse_toml, read_text
from groundstation.calibration.schema import CalibrationError, Finite, Vector


class _BenchPlanTable(BaseModel):
    model_config = ConfigDict(frozen=True, extra="forbid", allow_inf_nan=False)


class Dwell(_BenchPlanTable):
    """A stretch of the recording during which the reference stood still. Times [s] after the first scan."""

    start: float
    stop: float
    reference: Finite | Vector | None = None

    @model_validator(mode="after")
    def _forward(self) -> "Dwell":
        if self.stop <= self.start:
            raise ValueError(f"dwell: stop {self.stop:g} is not after start {self.start:g}")
        return self


class InstrumentFit(_BenchPlanTable):
    """One instrument fitted from the recording.

    field: magnitude of the field for procedure 'sphere' [output unit]. fit_temperature: bias as a line over temperature too.
    """

    instrument: str
    procedure: Literal["static_points", "speed_sweep", "vectors", "sphere"]
    method: str = ""
    degree: Annotated[int, Field(ge=1, le=5)] = 1
    reference_unit: Literal["output", "m/s"] = "output"
    reference_uncertainty: Annotated[float, Field(ge=0)] = 0.0
    systematic_uncertainty: Annotated[float, Field(ge=0)] = 0.0
    field: Annotated[float, Field(gt=0)] | None = None
    fit_temperature: bool = False
    dwell: tuple[Dwell, ...]

    @model_validator(mode="after")
    def _references(self) -> "InstrumentFit":
        required = {"static_points": float, "speed_sweep": float, "vectors": tuple, "sphere": type(None)}[
            self.procedure
        ]
        for d in self.dwell:
            if not isinstance(d.reference, required):
                shape = {float: "a number", tuple: "a vector [x, y, z]", type(None): "no reference"}[required]
                raise ValueError(f"dwell at {d.start:g} s: procedure {self.procedure} needs {shape}")
        if self.procedure == "sphere" and self.field is None:
            raise ValueError("field: procedure sphere needs the magnitude of the field")
        return self


class BenchPlan(_BenchPlanTable):
    format: Literal[1]
    fit: tuple[InstrumentFit, ...]


def load_plan(path: str | Path) -> BenchPlan:
    """Read a bench plan. Raises CalibrationError naming file and key."""
    return parse_plan(read_text(Path(path), "file", CalibrationError), str(path))


def parse_plan(text: str, where: str) -> BenchPlan:
    """A bench plan from its text. Raises CalibrationError naming `where` and the key."""
    try:
        return BenchPlan.model_validate(parse_toml(text, where, CalibrationError))
    except ValidationError as error:
        raise CalibrationError.of_validation(where, error) from error
