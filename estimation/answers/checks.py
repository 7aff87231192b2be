"""`check`: whether the instruments of a flight agree, and whether its record is sound."""

import math
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

from daq.utilities.packages import optional
from estimation.answers.answer import (
    Answer,
    Figures,
    Rows,
    picture_writers,
    plot_reconstructed,
    rounded_texts,
    table_writers,
)
from estimation.threads import single_threaded

if TYPE_CHECKING:
    import pandas as pd

    from estimation.compatibility.reconstruction import Compatibility, FactorEstimate
    from estimation.resolve import AnyAircraft, Flights
    from groundstation.flight import Flight
    from groundstation.flight.contradictions import Contradiction
    from groundstation.flight.findings import Finding


@single_threaded
def check(
    flights: "Flights",
    factors: "str | Sequence[str] | None" = None,
    joint: bool = False,
    *,
    aircraft: "AnyAircraft" = None,
    keep_held: bool = False,
    segments: str | None = None,
    align: str | None = None,
    progress: Callable[..., None] | None = None,
) -> "Check":
    """Check whether the instruments agree, and whether the record is sound.

    Args:
        flights: a Flight, a file, or a list of them; raw recordings are calibrated.
        factors: names, or text as for `--factors`; by default the standard ones.
        joint: also one set of factors that the flights share.
        aircraft: its derivatives predict the bounds of an estimate from each flight; by default what the flight carries.
        keep_held: take repeated values of slow and stuck sensors for measurements.
        segments: use only these stretches: "1:9,12:20" [s], "mode:FBWA", "V > 12".
        align: how the report aligns further flights with the first in time: auto, correlation, input, event or start.
        progress: called with a sentence on the present step, and the share done.

    Raises:
        UserError: one sentence, for what cannot be found or compared.

    Example::

        answer = ss.check("ld1.mcap")
        print(answer.agreement("ld1"))
    """
    from estimation.compatibility.reconstruction import compatibility
    from estimation.compatibility.records import left_out_findings
    from estimation.errors import EstimationError
    from estimation.resolve import read_flights
    from groundstation.flight.contradictions import contradictions
    from groundstation.flight.quality.report import quality_report

    text = factors if isinstance(factors, str) or factors is None else ",".join(factors) or None
    free_factors, fixed_factors = wanted_factors(text)
    report_progress = progress or (lambda *_: None)
    selected = read_flights(flights, segments)
    if align is not None and len(selected) < 2:
        raise EstimationError("--align lays flights on one another in time: give two or more")
    contradicted = {f.name: contradictions(f) for f in selected}
    results = {}
    several = len(selected) > 1  # one flight takes only a second or two
    for i, f in enumerate(selected):
        if several:
            report_progress(f"checking {f.name}", i / len(selected))
        results[f.name] = compatibility(f, free_factors, known=fixed_factors, keep_held=keep_held)
    quality = {
        f.name: (
            *quality_report(f, contradicted[f.name]),
            *left_out_findings(results[f.name].flights[0].left_out),
            *_excitation(f, aircraft),
        )
        for f in selected
    }
    shared = None
    if joint and several:
        report_progress("checking all together")
        shared = compatibility(selected, free_factors, known=fixed_factors, keep_held=keep_held)
    return Check(results, quality, contradicted, tuple(selected), shared, align)


def _excitation(flight: "Flight", aircraft: "AnyAircraft") -> "tuple[Finding, ...]":
    """Findings on how well the flight determines the derivatives of its aircraft; where it names none, one that says so."""
    from estimation.aircraft.library import aircraft_of
    from estimation.compatibility.excitation import CHECK, excitation_findings, predicted_bounds
    from groundstation.flight.findings import Finding

    if aircraft is None and not flight.provenance.aircraft:
        reason = "not predicted, for the flight names no aircraft; give one with --aircraft NAME or FILE"
        return (Finding(CHECK, reason, "ok"),)
    return tuple(excitation_findings(predicted_bounds(flight, aircraft_of([flight], aircraft))))


def wanted_factors(text: str | None) -> tuple[tuple[str, ...], dict[str, float]]:
    """(names of the factors to estimate, fixed factors with their values) for the text of --factors; None: the standard ones.

    Raises EstimationError for a text without names, a value that is no finite number, or nothing left to estimate.
    """
    from estimation.errors import EstimationError
    from estimation.models.kinematic import STANDARD_FACTORS

    if text is None:
        return STANDARD_FACTORS, {}
    words = [n.strip() for n in text.strip().removeprefix("+").split(",") if n.strip()]
    if not words:
        raise EstimationError(f"--factors {text!r} names none; write names like K_beta,dbeta or leave the option out")
    fixed: dict[str, float] = {}
    for word in [w for w in words if "=" in w]:
        name, _, value = word.partition("=")
        try:
            fixed[name.strip()] = float(value)
        except ValueError:
            raise EstimationError(f"--factors {word}: {value!r} is not a number; write it like x_imu=0.06") from None
        if not math.isfinite(fixed[name.strip()]):
            raise EstimationError(f"--factors {word}: not a finite number")
    names = tuple(w for w in words if "=" not in w)
    if text.strip().startswith("+") or not names:
        names = (*STANDARD_FACTORS, *names)
    free = tuple(n for n in dict.fromkeys(names) if n not in fixed)
    if not free:
        raise EstimationError(f"--factors {text}: every factor is given a value, none is left to estimate")
    return free, fixed


@dataclass(frozen=True, repr=False)
class Check(Answer):
    """The answer of `check`. results, quality, contradicted: factors, findings and contradictions by flight; joint: factors that
    all flights share; align: how the report aligns further flights with the first in time."""

    results: "Mapping[str, Compatibility]"
    quality: "Mapping[str, tuple[Finding, ...]]"
    contradicted: "Mapping[str, tuple[Contradiction, ...]]"
    flights: "tuple[Flight, ...]"
    joint: "Compatibility | None" = None
    align: str | None = None

    @property
    def named(self) -> "list[tuple[str, Compatibility]]":
        """(name, result) for the rows of tables: each flight, then "joint"."""
        return [*self.results.items(), *([] if self.joint is None else [("joint", self.joint)])]

    @property
    def passed(self) -> bool:
        """Whether no finding is a failure, and every reconstruction converged."""
        from groundstation.flight.findings import worst

        failed = any(worst(findings) == "fail" for findings in self.quality.values())
        return not failed and all(r.converged for _, r in self.named)

    def to_json(self) -> dict[str, Any]:
        """The content of `check --json`: one entry a flight, and the joint factors where there are any."""
        from estimation.report.check_page import fit_of

        entries, contradicted = [], []
        for flight in self.flights:
            contradicted += [{"flight": flight.name, **c.to_json()} for c in self.contradicted[flight.name]]
            result = self.results[flight.name]
            entries.append(
                {
                    "name": flight.name,
                    "converged": result.converged,
                    "status": result.text,
                    "agreement": self.agreement(flight.name),
                    "factors": {n: _factor_json(f) for n, f in result.factors.items()},
                    "fit": fit_of(result.flights[0]),
                    "notes": list(result.flights[0].notes),
                    "quality": [f.to_json() for f in self.quality[flight.name]],
                }
            )
        data: dict[str, Any] = {"version": 1, "flights": entries, "contradictions": contradicted}
        if self.joint is not None:
            data["joint"] = {n: _factor_json(f) for n, f in self.joint.factors.items()}
        return data

    def to_pandas(self) -> "pd.DataFrame":
        """A row for each flight and instrument factor."""
        pd = optional("pandas", "a table of pandas")

        rows = [
            {"flight": flight, "factor": n, "estimate": f.estimate, "std": f.std, "std_coloured": f.std_coloured,
             "unit": f.unit, "identifiable": f.identifiable, "why": f.why}
            for flight, result in self.named
            for n, f in result.factors.items()
        ]  # fmt: skip
        return pd.DataFrame(rows)

    def corrected(self) -> "list[Flight]":
        """The flights corrected by the estimated instrument factors."""
        from estimation.compatibility.correct import correct_flight

        return [correct_flight(flight, self.results[flight.name]) for flight in self.flights]

    def lines(self) -> Iterator[str]:
        from estimation.models.kinematic import STANDARD_FACTORS
        from estimation.report.check_page import factor_lines, published_lines
        from estimation.report.published import is_of

        yield from (self.agreement(f.name) for f in self.flights)
        yield ""
        yield from factor_lines(self.named)
        estimated = next(iter(self.results.values())).factors
        if all(is_of(f.provenance.aircraft) for f in self.flights) and set(STANDARD_FACTORS) <= set(estimated):
            yield ""
            yield from published_lines()
        for name, findings in self.quality.items():
            yield from ("", f"quality of {name}", *(f"  {f.severity:<5}{f.kind}: {f.text}" for f in findings))

    def agreement(self, flight: str) -> str:
        """Whether the instruments of a flight agree, in a sentence."""
        from groundstation.flight.findings import worst

        result, findings = self.results[flight], self.quality[flight]
        if not result.converged:
            return f"{flight}: no motion was found that the instruments agree on: {result.text}"
        miscalibrated = [n for n, f in result.factors.items() if f.identifiable and _is_off(f)]
        text = (
            f"agree once {', '.join(miscalibrated)} {'is' if len(miscalibrated) == 1 else 'are'} corrected"
            if miscalibrated
            else "agree"
        )
        if worst(findings) != "fail":
            return f"{flight}: the instruments {text}"
        failed = ", ".join(dict.fromkeys(f.kind for f in findings if f.severity == "fail"))
        return f"{flight}: the instruments {text}, but the record fails a check: {failed}"

    def plot(self, ax: Any = None) -> Any:
        """Draw measured and reconstructed motion of the first flight, one axes a channel; returns the axes."""
        return plot_reconstructed(next(iter(self.results.values())).flights[0], ax)

    def figures(self) -> Figures:
        from functools import partial

        from estimation.report.check_page import motion_figure, motion_pairs

        pairs = motion_pairs([self.results[f.name].flights[0] for f in self.flights])
        return Figures(
            {f"figure7_{i + 1}": partial(motion_figure, pair, i, self.flights) for i, pair in enumerate(pairs)}
        )

    def report(self, folder: str | Path) -> Path:
        from estimation.report.check_page import write_check_report

        quality = [self.quality[f.name] for f in self.flights]
        agreement = [self.agreement(f.name) for f in self.flights]
        return write_check_report(self.flights, quality, self.named, Path(folder), self.align, agreement)

    def writers(self) -> Mapping[str, Callable[[Path], Any]]:
        """Everything as .json, the table of factors as .csv, measured and reconstructed motion as a picture."""
        from estimation.report.check_page import write_figure

        motion = [self.results[f.name].flights[0] for f in self.flights]
        pictures = picture_writers(lambda path: write_figure(motion, path))
        return {**super().writers(), **table_writers(self), **pictures}

    def headline(self) -> str:
        from groundstation.flight.findings import worst

        verdict = worst(f for findings in self.quality.values() for f in findings if f.severity != "note")
        return f"Check of {', '.join(self.quality)}: {verdict}"

    def rows(self) -> Rows:
        """A row for each flight and factor."""
        rows = [
            (flight, n, *rounded_texts(f), f.unit) for flight, result in self.named for n, f in result.factors.items()
        ]
        return ("flight", "factor", "estimate", "corrected bound", "unit"), rows


OFF_BOUNDS = 3.0  # corrected bounds from a perfect instrument: noise alone exceeds that for one in 370 factors


def _is_off(factor: "FactorEstimate") -> bool:
    """Whether an instrument factor differs from a perfect instrument's by more than its bound explains."""
    perfect = 1.0 if factor.name.startswith("K_") else 0.0
    return abs(factor.estimate - perfect) > OFF_BOUNDS * factor.std_coloured


def _factor_json(factor: "FactorEstimate") -> dict[str, object]:
    """A factor in JSON; numbers that are not finite, where the channel is not measured, are null."""
    from estimation.estimators.result import finite_or_none

    numbers = {"estimate": factor.estimate, "std": factor.std, "std_coloured": factor.std_coloured}
    data: dict[str, object] = {
        **{k: finite_or_none(v) for k, v in numbers.items()},
        "unit": factor.unit,
        "identifiable": factor.identifiable,
    }
    return data if factor.identifiable else {**data, "why": factor.why}
