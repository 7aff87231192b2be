"""A line of the go/no-go table."""

from dataclasses import dataclass
from enum import StrEnum


class PreflightVerdict(StrEnum):
    """What a check says."""

    GO = "go"
    CAUTION = "caution"
    NO_GO = "no-go"


@dataclass(frozen=True, slots=True)
class PreflightCheck:
    """One line of the table. of_sequencer: it concerns what moves the controls."""

    name: str
    verdict: PreflightVerdict
    text: str
    of_sequencer: bool = False
