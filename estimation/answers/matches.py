"""`match`: proof of match, the prediction of flights that the model was not estimated from."""

from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

from daq.utilities.packages import optional
from daq.utilities.plain_words import comma_separated
from estimation.answers.answer import Answer, Figures, Rows, picture_writers, plot_proof, table_writers
from estimation.signals.goodness_of_fit import THEIL_LIMIT
from estimation.threads import single_threaded

if TYPE_CHECKING:
    import pandas as pd

    from estimation.resolve import AnyAircraft, AnyModel, Flights, Names
    from estimation.session.proof_of_match import ProofOfMatch
    from groundstation.flight import Flight


@single_threaded
def match(
    model: "AnyModel",
    flights: "Flights",
    free: "Names" = (),
    *,
    aircraft: "AnyAircraft" = None,
    simulation: str | None = None,
    segments: str | None = None,
    limit: float = THEIL_LIMIT,
) -> "Match":
    """Predict flights with the model's parameters frozen.

    Args:
        model: "lateral", "lateral-simple", "longitudinal", "six-dof", a model file, "module:Class" or a Model.
        flights: a Flight, a file, or a list of them; raw recordings are calibrated.
        free: parameters that are still fitted to each flight, such as CY_0.
        aircraft: a built-in name or a file; by default what the flights carry.
        simulation: your own simulation as the base of the model, such as "jsbsim:AIRCRAFT" or "module:function".
        segments: use only these stretches: "1:9,12:20" [s], "mode:FBWA", "V > 12".
        limit: largest Theil's coefficient of a channel that matches, in excess of what the channel's noise alone causes.

    Raises:
        UserError: one sentence, for what cannot be found, or flights that cannot feed the model.

    Example::

        answer = ss.match("model.toml", "ld2.mcap", free="CY_0,Cl_0,Cn_0")
        print(answer.passed)
    """
    from estimation.resolve import resolve
    from estimation.session.proof_of_match import predict_flight
    from estimation.simulation.base_model import Free

    problem = resolve(flights, model, aircraft, segments=segments, simulation=simulation, free=Free.NOTHING)
    free_names = comma_separated(free)
    proofs = tuple(predict_flight(problem.model, flight, free=free_names) for flight in problem.flights)
    return Match(proofs, str(problem.model.name), limit, problem.flights, problem.notes)


@dataclass(frozen=True, repr=False)
class Match(Answer):
    """Proofs of match, one for each flight. limit: of Theil's coefficient; notes: which inputs a simulation holds constant, which
    mass was used."""

    proofs: "tuple[ProofOfMatch, ...]"
    model: str
    limit: float
    flights: "tuple[Flight, ...]"
    notes: tuple[str, ...] = ()

    @property
    def passed(self) -> bool:
        """Whether every channel of every flight matches."""
        return all(p.converged and all(f.matches(self.limit) for f in p.fit.values()) for p in self.proofs)

    def to_json(self) -> dict[str, Any]:
        return {"model": self.model, "limit": self.limit, "flights": [p.to_json() for p in self.proofs]}

    def to_pandas(self) -> "pd.DataFrame":
        """A row for each flight and channel: coefficient of determination, Theil's coefficient, rms."""
        pd = optional("pandas", "a table of pandas")

        rows = [
            {"flight": p.name, "channel": n, "r2": f.r2, "theil": f.theil, "rms": f.rms, "whiteness": f.whiteness}
            for p in self.proofs
            for n, f in p.fit.items()
        ]
        return pd.DataFrame(rows)

    def lines(self) -> Iterator[str]:
        yield from self.notes
        yield f"limit: Theil's coefficient {self.limit:g} in every channel, beyond what its noise alone leaves"
        for proof in self.proofs:
            yield from _proof_lines(proof, self.limit)

    def plot(self, ax: Any = None) -> Any:
        """Draw measured and predicted outputs of the first flight, one axes a channel; returns the axes."""
        return plot_proof(self.proofs[0], ax)

    def figures(self) -> Figures:
        from functools import partial

        from estimation.report.drawing.estimate_figures import proof_figure

        figure = partial(proof_figure, [(self.model, p) for p in self.proofs], "initial states", of_paper=False)
        return Figures({"figure10": figure})

    def write_histories(self, folder: Path) -> list[Path]:
        """Write each flight with the predicted columns beside the measured ones; returns the files."""
        from estimation.report.drawing.histories import write_beside

        return [write_beside(f, p.result, folder) for f, p in zip(self.flights, self.proofs, strict=True)]

    def writers(self) -> Mapping[str, Callable[[Path], Any]]:
        """Everything as .json, the table as .csv, measured and predicted histories as a picture."""
        from estimation.report.drawing.histories import write_proof

        pictures = picture_writers(lambda path: write_proof(self.proofs, path))
        return {**super().writers(), **table_writers(self), **pictures}

    def headline(self) -> str:
        channels = [(p.name, n, f.matches(self.limit)) for p in self.proofs for n, f in p.fit.items()]
        failed = [n if len(self.proofs) == 1 else f"{n} of {name}" for name, n, matches in channels if not matches]
        verdict = f"{', '.join(failed)} beyond the limit" if failed else "every channel within its limit"
        return f"Match of {', '.join(p.name for p in self.proofs)}: {verdict}"

    def rows(self) -> Rows:
        """A row for each flight and channel."""
        rows = [
            (p.name, n, f"{f.r2:.3f}", f"{f.theil:.3f}", f"{f.rms:.3g}") for p in self.proofs for n, f in p.fit.items()
        ]
        return ("flight", "channel", "r2", "Theil", "rms"), rows


def _proof_lines(proof: "ProofOfMatch", limit: float) -> list[str]:
    """The printed lines for one predicted flight."""
    head = f"  {'channel':<10}{'r2':>8}{'Theil':>8}{'bias':>7}{'var':>7}{'cov':>7}{'rms':>11}{'white':>7}{'limit':>7}  match"
    lines = [f"{proof.name}: {proof.text}", head]
    for name, f in proof.fit.items():
        verdict = "pass" if f.matches(limit) else "FAIL"
        lines.append(
            f"  {name:<10}{f.r2:8.3f}{f.theil:8.3f}{f.theil_bias:7.2f}{f.theil_variance:7.2f}"
            f"{f.theil_covariance:7.2f}{f.rms:11.4g}{f.whiteness:7.2f}{f.limit(limit):7.2f}  {verdict}"
        )
    if proof.estimated_from:
        lines.append(
            "  the model was estimated from this flight: this shows the fit and proves no match; predict another"
        )
    lines += [f"  beyond what the model was estimated from: {b.text}" for b in proof.beyond]
    return [*lines, *(f"  note: {note}" for note in proof.result.flights[0].notes)]
