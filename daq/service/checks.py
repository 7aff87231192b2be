"""A line of the go/no-go table."""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from enum import StrEnum

from daq.acquisition.air_truth import BROKEN_PA, OFFSET_PA, Scales, level, pitot_at_rest
from daq.config import LoggerConfig
from daq.contract.scan import Scan
from daq.sensors.standstill import LEAST_SCANS, counts, unrest


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


def rest_checks(config: LoggerConfig, scans: Sequence[Scan]) -> Iterator[PreflightCheck]:
    """Level attitude and pitot offset; a caution instead of them while something moves."""
    scales = Scales(config.sensors)
    motion = unrest(scans)
    if motion:
        yield PreflightCheck(
            "at rest",
            PreflightVerdict.CAUTION,
            f"{motion}: level and pitot zero were not looked at; leave the aircraft alone",
        )
        return
    attitude = level(scans, scales)
    if attitude is not None:
        yield PreflightCheck("level", PreflightVerdict.GO if attitude[0] else PreflightVerdict.NO_GO, attitude[1])
    if len(counts(scans, "pitot_pressure")) >= LEAST_SCANS:
        yield from _pitot(config, scans, scales)


def _pitot(config: LoggerConfig, scans: Sequence[Scan], scales: Scales) -> Iterator[PreflightCheck]:
    rest = pitot_at_rest(scans, scales)
    if rest is None:
        return
    reads = f"pitot reads {rest.words} while GPS and gyro say at rest (limit {OFFSET_PA:.0f} Pa)"
    if abs(rest.offset_pa) <= OFFSET_PA:
        yield PreflightCheck("pitot zero", PreflightVerdict.GO, reads)
    elif abs(rest.offset_pa) > BROKEN_PA:
        text = f"{reads}, more than any zero ({BROKEN_PA:.0f} Pa); look for a kinked tube, or correct sensors.pitot.range_pa"
        yield PreflightCheck("pitot zero", PreflightVerdict.NO_GO, text)
    elif not rest.steady:
        yield PreflightCheck(
            "pitot zero", PreflightVerdict.CAUTION, f"{reads}, unsteady: wind? Cover the tube and repeat, then zero it"
        )
    elif config.preflight.auto_zero:
        yield PreflightCheck(
            "pitot zero", PreflightVerdict.CAUTION, f"{reads}: zero it, or leave it at rest for 5 s and the logger does"
        )
    else:
        yield PreflightCheck("pitot zero", PreflightVerdict.NO_GO, f"{reads}: zero it (`zero` at the ground station)")
