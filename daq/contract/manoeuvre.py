"""A manoeuvre as a file: increments of the controls over time, with what it was designed for and a digest.

The ground designs it, the sequencer on board flies it; both read it here, and neither flies a file whose digest does not
fit its values. Increments are in radians about the pilot's own signals at the start, with the signs of the flight columns, and
begin and end at zero.
"""

import hashlib
import json
import math
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from daq.contract.channels import COLUMN_BY_NAME
from daq.utilities.errors import UserError
from daq.utilities.input_files import read_toml

VERSION = 1
STEP_RANGE = (0.005, 0.1)
"""Time steps that a file may have [s]: servos take pulses at 10 to 200 Hz."""
LONGEST_S = 600.0
LARGEST = math.radians(30.0)
"""No increment is larger [rad], whatever a file says: a small aircraft's surfaces do not go further from trim."""
AT_REST = math.radians(0.05)
"""Increments at both ends may differ from zero by so much [rad]: less than a step of a 12-bit servo driver (0.24 deg)."""
FINENESS = 1e-7
"""Increments are rounded to this before the digest is made [rad], so that writing and reading change nothing."""


class ManoeuvreError(UserError):
    """A manoeuvre file that cannot be used."""


@dataclass(frozen=True)
class Manoeuvre:
    """increments: control column -> (N,) [rad] at `time_step` [s]. limits, predicted, about: for people and pages."""

    kind: str
    time_step: float
    increments: Mapping[str, tuple[float, ...]]
    aircraft: str = ""
    model: str = ""
    limits: Mapping[str, Any] = field(default_factory=dict)
    predicted: Mapping[str, Any] = field(default_factory=dict)
    about: Mapping[str, Any] = field(default_factory=dict)

    @property
    def samples(self) -> int:
        return len(next(iter(self.increments.values())))

    @property
    def duration_s(self) -> float:
        """From the first sample to the last."""
        return (self.samples - 1) * self.time_step

    @property
    def digest(self) -> str:
        """SHA-256 of what would be flown: time step and increments."""
        steps = {name: [round(v / FINENESS) for v in values] for name, values in sorted(self.increments.items())}
        text = json.dumps([VERSION, round(self.time_step * 1e6), steps], separators=(",", ":"))
        return hashlib.sha256(text.encode()).hexdigest()

    def to_dict(self) -> dict[str, Any]:
        return {
            "version": VERSION,
            "kind": self.kind,
            "aircraft": self.aircraft,
            "model": self.model,
            "time_step": self.time_step,
            "digest": self.digest,
            "about": dict(self.about),
            "limits": dict(self.limits),
            "predicted": dict(self.predicted),
            "increments": {name: list(values) for name, values in self.increments.items()},
        }


ManoeuvreCheck = Callable[[Manoeuvre], Callable[[], str]]
"""Checks a manoeuvre against the aircraft's limits, in any thread; raises ManoeuvreError. Returns a function that loads the
manoeuvre, to be called in the scan loop, which returns why it is refused, or ""."""


def checked(manoeuvre: Manoeuvre, where: str = "manoeuvre") -> Manoeuvre:
    """The manoeuvre, if it could be flown at all. Raises ManoeuvreError naming what is wrong."""

    def refusal(what: str) -> ManoeuvreError:
        return ManoeuvreError(f"{where}: {what}; design it again with 'sideslip design'")

    if not manoeuvre.increments:
        raise refusal("no control is moved")
    if not STEP_RANGE[0] <= manoeuvre.time_step <= STEP_RANGE[1]:
        raise refusal(f"time_step {manoeuvre.time_step:g} s is not from {STEP_RANGE[0]:g} to {STEP_RANGE[1]:g} s")
    lengths = {len(values) for values in manoeuvre.increments.values()}
    if len(lengths) > 1 or min(lengths) < 2:
        raise refusal("the controls differ in number of samples" if len(lengths) > 1 else "fewer than two samples")
    if manoeuvre.duration_s > LONGEST_S:
        raise refusal(f"{manoeuvre.duration_s:.0f} s long, at most {LONGEST_S:.0f} s can be flown")
    for name, values in manoeuvre.increments.items():
        column = COLUMN_BY_NAME.get(name)
        if column is None or not name.startswith("delta_"):
            raise refusal(f"{name!r} is not a control; known are delta_e, delta_a, delta_r")
        if not all(math.isfinite(v) and abs(v) <= LARGEST for v in values):
            raise refusal(f"{name} has an increment beyond {math.degrees(LARGEST):.0f} deg or none at all")
        if max(abs(values[0]), abs(values[-1])) > AT_REST:
            raise refusal(f"{name} does not begin and end at zero")
    return manoeuvre


def load_manoeuvre(path: str | Path) -> Manoeuvre:
    """Read and check a manoeuvre file. Raises ManoeuvreError with one sentence; a wrong digest is refused."""
    path = Path(path)
    data = read_toml(path, "manoeuvre file", ManoeuvreError)
    if data.get("version") != VERSION:
        raise ManoeuvreError(f"{path}: not a manoeuvre of version {VERSION}; design it with this release")
    try:
        manoeuvre = _manoeuvre(data)
    except (KeyError, TypeError, ValueError, AttributeError) as error:
        raise ManoeuvreError(f"{path}: not what 'sideslip design' writes ({error!r}); design it again") from error
    checked(manoeuvre, str(path))
    if data.get("digest") != manoeuvre.digest:
        raise ManoeuvreError(f"{path}: its digest does not fit its values: it was changed; design it again")
    return manoeuvre


def _manoeuvre(data: Mapping[str, Any]) -> Manoeuvre:
    return Manoeuvre(
        kind=str(data["kind"]),
        time_step=float(data["time_step"]),
        increments={str(name): tuple(float(v) for v in values) for name, values in data["increments"].items()},
        aircraft=str(data.get("aircraft", "")),
        model=str(data.get("model", "")),
        limits=dict(data.get("limits", {})),
        predicted=dict(data.get("predicted", {})),
        about=dict(data.get("about", {})),
    )
