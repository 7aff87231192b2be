"""`[identification]`: live identification on board."""

from typing import Annotated

from pydantic import BaseModel, ConfigDict, Field


class IdentificationConfig(BaseModel):
    """Needs `calibration`, and `aircraft.file` or a built-in `aircraft.name`.

    model: lateral, longitudinal, six-dof, or the file of a model, estimated in flight; empty: lateral. every_s: time between two
    answers. command: the process; empty: this Python's own `-m sideslip.onboard`. niceness: its own.
    """

    model_config = ConfigDict(extra="forbid", frozen=True, allow_inf_nan=False)

    model: str = ""
    every_s: Annotated[float, Field(ge=1.0, le=600.0)] = 5.0
    command: tuple[str, ...] = ()
    niceness: Annotated[int, Field(ge=0, le=19)] = 10
