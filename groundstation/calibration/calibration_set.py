"""Calibration sets: the files of all instruments of one aircraft, read and checked, with their texts and hashes.

A set is a directory of such files. It is embedded in every recording as text, so that a flight can be calibrated again
from the file alone, and a later, better set can take its place (`--calibration DIR`).
"""

import hashlib
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from types import MappingProxyType

from pydantic import ValidationError

from daq.utilities.input_files import parse_toml, read_text
from groundstation.calibration.schema import CalibrationError, Instrument

NOMINAL_DIRECTORY = Path(__file__).parent / "files"


@dataclass(frozen=True)
class CalibrationSet:
    """The calibration of every instrument of one aircraft, with the texts it was read from.

    texts: file name -> TOML text, as embedded in a recording. A set without some instrument leaves its columns unmeasured.
    """

    name: str
    instruments: Mapping[str, Instrument]
    texts: Mapping[str, str]

    @classmethod
    def from_texts(cls, name: str, texts: Mapping[str, str]) -> "CalibrationSet":
        """A set from TOML texts by file name (with or without '.toml').

        Raises CalibrationError naming file and key.
        """
        instruments: dict[str, Instrument] = {}
        for file, text in sorted(texts.items()):
            item = _parse(f"{name}/{file}", text)
            if item.instrument in instruments:
                raise CalibrationError(f"{name}/{file}: instrument {item.instrument} is calibrated twice in this set")
            instruments[item.instrument] = item
        if not instruments:
            raise CalibrationError(f"{name}: no calibration file in it; give a directory of .toml files")
        return cls(name, MappingProxyType(instruments), MappingProxyType(dict(sorted(texts.items()))))

    @property
    def hashes(self) -> dict[str, str]:
        """SHA-256 of each file's text."""
        return {file: hashlib.sha256(text.encode()).hexdigest() for file, text in self.texts.items()}

    def get(self, instrument: str) -> Instrument | None:
        """The calibration of an instrument, None when the set has none."""
        return self.instruments.get(instrument)

    @property
    def facts(self) -> Mapping[str, str]:
        """Facts about the logger's sensors that the set holds."""
        item = self.get("logger")
        return item.logger.facts if item and item.logger else {}

    def with_texts(self, texts: Mapping[str, str]) -> "CalibrationSet":
        """A set with files added or replaced, by file name."""
        return CalibrationSet.from_texts(self.name, {**self.texts, **texts})


def load_calibration(directory: str | Path = "cdfp") -> CalibrationSet:
    """Read a calibration set from a directory, or a built-in one by name ('cdfp').

    Raises CalibrationError naming the file and the key that is wrong.
    """
    path = Path(directory)
    if not path.is_dir():
        built_in = NOMINAL_DIRECTORY / str(directory)
        if path.name != str(directory) or not built_in.is_dir():
            names = ", ".join(sorted(p.name for p in NOMINAL_DIRECTORY.iterdir() if p.is_dir()))
            raise CalibrationError(f"{directory}: no such directory of calibration files (built in: {names})")
        path = built_in
    texts = {file.name: read_text(file, "file", CalibrationError) for file in sorted(path.glob("*.toml"))}
    return CalibrationSet.from_texts(path.name, texts)


def _parse(where: str, text: str) -> Instrument:
    try:
        return Instrument.model_validate(parse_toml(text, where, CalibrationError))
    except ValidationError as error:
        raise CalibrationError.of_validation(where, error) from error


def to_toml(instrument: Instrument) -> str:
    """The text of an instrument's file, without values that are unset or at their default."""
    import tomli_w

    return tomli_w.dumps(instrument.model_dump(exclude_defaults=True, exclude_none=True))
