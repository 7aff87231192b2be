"""A response with what was fitted to it and what that says: the whole answer, as lines, as JSON."""

from collections.abc import Iterator
from dataclasses import dataclass, field
from typing import Any

from daq.contract.constants import RADIAN
from estimation.frequency.handling import Craft, Number, handling
from estimation.frequency.response import FrequencyResponse
from estimation.frequency.transfer import TransferFunction, fit_transfer

ACCEPTABLE = 100.0  # CIFER's J; Tischler and Remple, chapter 11
LINES = 16  # frequencies that the terminal shows


@dataclass(frozen=True)
class FrequencyResult:
    """fit: None where none was asked for. numbers: of handling qualities."""

    response: FrequencyResponse
    fit: TransferFunction | None = None
    numbers: tuple[Number, ...] = ()
    craft: Craft = field(default_factory=Craft)

    def to_json(self) -> dict[str, Any]:
        data = self.response.to_json()
        if self.fit is None:
            return data
        return {
            **data,
            "fit": {
                **self.fit.to_json(),
                "handling": [n.to_json() for n in self.numbers],
                "levels": self.craft.why_no_level or f"class {self.craft.kind}, category {self.craft.category}",
                "status": judged(self.fit),
            },
        }


def answer(response: FrequencyResponse, form: str | None, craft: Craft) -> FrequencyResult:
    """The response, with a fit of `form` where one is given."""
    if form is None:
        return FrequencyResult(response, craft=craft)
    fit = fit_transfer(response, form)
    return FrequencyResult(response, fit, handling(response, fit, craft), craft)


def judged(fit: TransferFunction) -> str:
    """Whether to believe a fit."""
    if fit.cost > ACCEPTABLE:
        return (
            f"the form does not describe the data (cost {fit.cost:.0f}, acceptable up to {ACCEPTABLE:g}); fit "
            "another form or a narrower band"
        )
    return f"the form describes the data (cost {fit.cost:.1f}, acceptable up to {ACCEPTABLE:g})"


def lines(found: FrequencyResult) -> Iterator[str]:
    """What a person reads on the terminal."""
    r = found.response
    beside = f", with {', '.join(r.inputs[1:])} taken off" if len(r.inputs) > 1 else ""
    yield (
        f"{r.output} to {r.input}{beside}: {r.omega.size} frequencies from {r.omega[0]:.3g} to "
        f"{r.omega[-1]:.3g} rad/s, {r.duration:.4g} s of data"
    )
    yield f"  {'rad/s':>8}{'magnitude':>12}{'+-':>10}{'phase [deg]':>13}{'+-':>8}{'coherence':>11}"
    for k in range(0, r.omega.size, max(1, -(-r.omega.size // LINES))):
        phase, error = RADIAN * r.phase[k], RADIAN * r.std_phase[k]
        yield (
            f"  {r.omega[k]:8.3g}{r.magnitude[k]:12.4g}{r.std[k]:10.2g}{phase:13.1f}{error:8.1f}{r.coherence[k]:11.2f}"
        )
    if r.left_out:
        yield f"  left out for low coherence or large error: {len(r.left_out)} frequencies"
    for note in r.notes:
        yield f"  note: {note}"
    if found.fit is not None:
        yield from _fit_lines(found, found.fit)


def _fit_lines(found: FrequencyResult, fit: TransferFunction) -> Iterator[str]:
    yield ""
    yield f"fit {fit.form.name}, {fit.points} frequencies from {fit.omega[0]:.3g} to {fit.omega[1]:.3g} rad/s: {judged(fit)}"
    yield f"  H = {fit.form.equation}"
    yield f"  {'parameter':<12}{'estimate':>11}{'bound':>10}{'CIFER cost':>12}"
    for name, p in fit.parameters.items():
        yield f"  {name:<12}{p.estimate:11.4g}{p.std:10.2g}{fit.cifer[name]:12.4g}  {p.unit}"
    for n in found.numbers:
        bound = f" +- {n.std:.2g}" if n.std == n.std else ""
        level = "" if n.level is None else ", beyond level 3" if n.level > 3 else f", level {n.level}"
        unit = "" if n.unit == "1" else f" {n.unit}"
        yield f"  {n.name} = {n.value:.4g}{bound}{unit}: {n.definition} ({n.source}){level}"
    if found.craft.why_no_level:
        yield f"  {found.craft.why_no_level}"
