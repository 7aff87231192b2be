"""A line of the go/no-go table."""

from dataclasses import dataclass
from enum import StrEnum


class Verdict(StrEnum):
    """What a check says."""

    GO = "go"
    CAUTION = "caution"
    NO_GO = "no-go"


@dataclass(frozen=True, slots=True)
class Check:
    """One line of the table. of_sequencer: it concerns what moves the controls."""

    name: str
    verdict: Verdict
    text: str
    of_sequencer: bool = False
