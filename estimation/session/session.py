"""The results of one call of `estimate`, to be printed, written as JSON and shown in the report."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any

from estimation.aircraft import Aircraft
from estimation.estimators.registry import estimator_names
from estimation.estimators.result import Result, finite_or_none
from estimation.models.base import Model
from estimation.session.evidence import Scatter
from estimation.session.sanity_checks import Doubt, doubts_of
from estimation.session.verdict import Verdict
from estimation.structure.odd_flights import OddFlight
from estimation.structure.score_test import StructureTest
from groundstation.flight import Flight
from groundstation.flight.findings import finding_texts


@dataclass(frozen=True)
class FlightEstimates:
    """Results of every method on one flight. failures: method -> why it gives no result."""

    flight: Flight
    results: Mapping[str, Result]
    failures: Mapping[str, str] = field(default_factory=dict)
    verdict: Verdict | None = None
    structure: StructureTest | None = None

    @property
    def notes(self) -> tuple[str, ...]:
        """Sentences on what was done to the data, and the doubts about the first method's result."""
        first = self._first
        return (
            *finding_texts((self.flight if first is None else first.flights[0]).notes),
            *(d.text for d in self.doubts),
        )

    @property
    def doubts(self) -> tuple[Doubt, ...]:
        """Doubts about the first method's result."""
        return () if self._first is None else tuple(doubts_of(self._first))

    @property
    def _first(self) -> Result | None:
        return next((r for r in self.results.values() if r.flights), None)


@dataclass(frozen=True)
class EstimationSession:
    """Results of one call of `estimate`. truth: derivatives of simulated flights, shown beside the means.

    joint_failures: method -> why it gives no joint estimate. Of the joint estimates, where there are any: verdict; structure:
    what their model lacks; odd: flights that differ from the others."""

    aircraft: Aircraft
    model: Model
    methods: tuple[str, ...]
    flights: tuple[FlightEstimates, ...]
    joint: Mapping[str, Result]
    mean: Mapping[str, Mapping[str, Scatter]]
    truth: Mapping[str, float] = field(default_factory=dict)
    joint_failures: Mapping[str, str] = field(default_factory=dict)
    verdict: Verdict | None = None
    structure: StructureTest | None = None
    odd: tuple[OddFlight, ...] = ()

    def __repr__(self) -> str:
        return f"<EstimationSession of {self.model.name} by {', '.join(self.methods)}: {self.text:.200}>"

    @property
    def leading(self) -> Result | None:
        """The joint estimate that figures and tables show: the recommended one, else the default method's, else the first."""
        method = "" if self.verdict is None else self.verdict.recommended.method
        return self.joint.get(method) or self.joint.get(estimator_names()[0]) or next(iter(self.joint.values()), None)

    @property
    def converged(self) -> bool:
        """Whether every method converged on every flight."""
        results = [r for f in self.flights for r in f.results.values()] + list(self.joint.values())
        failures = self.joint_failures or any(f.failures for f in self.flights)
        return bool(results) and all(r.converged for r in results) and not failures

    @property
    def text(self) -> str:
        """One sentence: how many flights were estimated, what did not converge, what the data cannot tell."""
        not_converged = [
            f"{f.flight.name} ({m})" for f in self.flights for m, r in f.results.items() if not r.converged
        ]
        not_converged += [f"{f.flight.name} ({m})" for f in self.flights for m in f.failures]
        not_converged += [f"joint ({m})" for m, r in self.joint.items() if not r.converged]
        not_converged += [f"joint ({m})" for m in self.joint_failures]
        if not_converged:
            return f"not converged: {', '.join(not_converged)}"
        blind = sorted(
            {n for f in self.flights for r in f.results.values() for n, e in r.parameters.items() if not e.identifiable}
        )
        summary = f"{len(self.flights)} flight{'s' if len(self.flights) > 1 else ''} estimated"
        if not blind:
            return summary
        return f"{summary}; in some flights the data cannot tell {', '.join(blind)}{self._together(blind)}"

    def _together(self, blind: list[str]) -> str:
        """What the joint estimate makes of parameters that some flights cannot tell."""
        joint = next(iter(self.joint.values()), None)
        if joint is None:
            return ""
        undetermined = [n for n in blind if n in joint.parameters and not joint.parameters[n].identifiable]
        return f"; nor can all together tell {', '.join(undetermined)}" if undetermined else "; all together can"

    def to_json(self) -> dict[str, Any]:
        """The JSON of `estimate --json`."""
        first = self.joint or (self.flights[0].results if self.flights else {})
        collinear = next((r.collinear for r in first.values()), ())
        return {
            "version": 1,
            "aircraft": self.aircraft.name,
            **({"aircraft_file": self.aircraft.text} if self.aircraft.text else {}),
            "model": self.model.name,
            "status": self.text,
            "flights": [_flight_json(f) for f in self.flights],
            "mean": {
                method: {n: {"mean": finite_or_none(s.mean), "std": finite_or_none(s.std)} for n, s in table.items()}
                for method, table in self.mean.items()
            },
            "joint": {method: r.to_json() for method, r in self.joint.items()},
            "collinear": [list(pair) for pair in collinear],
            **_verdict_json(self.verdict),
            **({} if self.structure is None else {"structure": self.structure.to_json()}),
            **({} if not self.joint else {"odd": [o.to_json() for o in self.odd]}),
            **({"joint_failures": dict(self.joint_failures)} if self.joint_failures else {}),
            **({"truth": dict(self.truth)} if self.truth else {}),
            "scatter": {
                method: {
                    n: {"ratio": finite_or_none(s.ratio), "probability": s.probability, "text": s.text}
                    for n, s in table.items()
                    if s.count > 1
                }
                for method, table in self.mean.items()
            },
        }


def _flight_json(f: FlightEstimates) -> dict[str, Any]:
    data: dict[str, Any] = {
        "name": f.flight.name,
        "samples": len(f.flight),
        "methods": {m: r.to_json() for m, r in f.results.items()},
    }
    for method, reason in f.failures.items():
        data["methods"][method] = {"converged": False, "status": reason, "parameters": {}, "fit": {}}
    data |= _verdict_json(f.verdict, f.doubts)
    if f.structure is not None:
        data["structure"] = f.structure.to_json()
    data["notes"] = list(f.notes)
    data["provenance"] = {"path": f.flight.provenance.path, "sha256": f.flight.provenance.sha256}
    return data


def _verdict_json(verdict: Verdict | None, more_doubts: Sequence[Doubt] = ()) -> dict[str, Any]:
    """`recommended` and `doubts`; nothing where there is no verdict. more_doubts: doubts beside those of the verdict."""
    if verdict is None:
        return {}
    return {
        "recommended": verdict.recommended.to_json(),
        "doubts": [d.to_json() for d in (*verdict.doubts, *more_doubts)],
    }
