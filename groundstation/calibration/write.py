"""A calibration file as TOML text, exact to the last digit when it is read back."""

import tomli_w

from groundstation.calibration.schema import Instrument


def to_toml(instrument: Instrument) -> str:
    """The file's text: what is unset or at its default is left out, except what identifies it."""
    return tomli_w.dumps(instrument.model_dump(exclude_defaults=True, exclude_none=True))
