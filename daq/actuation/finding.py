"""What a trial before the flight finds."""

from dataclasses import dataclass

from daq.actuation.config import SequencerConfig
from daq.actuation.servos import plan_of
from daq.contract.manoeuvre import ManoeuvreError, load_manoeuvre


@dataclass(frozen=True, slots=True)
class TrialFinding:
    """One thing tried: well or not, in words."""

    what: str
    well: bool
    text: str


def try_manoeuvre(config: SequencerConfig) -> TrialFinding:
    """Whether the configured manoeuvre is one this aircraft may fly."""
    try:
        plan = plan_of(load_manoeuvre(config.manoeuvre), config)
    except ManoeuvreError as error:
        return TrialFinding("manoeuvre", False, str(error))
    return TrialFinding("manoeuvre", True, f"{plan.digest[:6]}, {plan.duration_s:.1f} s, within this aircraft's limits")
