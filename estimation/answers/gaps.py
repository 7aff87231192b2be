"""`gap`: where model and flights disagree, the effects that explain it, and the model with these effects."""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

from daq.utilities.packages import optional
from estimation.answers.answer import Answer, Figures, Rows, html_table, plot_scores, table_writers
from estimation.threads import single_threaded

if TYPE_CHECKING:
    import pandas as pd

    from estimation.gap.answer.result import GapResult
    from estimation.gap.effects.base import Effect
    from estimation.models import Model
    from estimation.resolve import AnyAircraft, AnyModel, Flights, ResolvedCall
    from groundstation.flight import Flight


@single_threaded
def gap(
    model: "AnyModel",
    flights: "Flights",
    holdout: "Flights" = (),
    *,
    aircraft: "AnyAircraft" = None,
    simulation: str | None = None,
    effects: Sequence[str | Path] = (),
    seed: int = 1,
    nulls: int = 200,
    progress: Callable[[str, float], None] | None = None,
) -> "GapAnswer":
    """Find what the model of the flights is missing.

    Args:
        model: "lateral", "lateral-simple", "longitudinal", "six-dof", a model file, "module:Class" or a Model.
        flights: a Flight, a file, or a list of them; raw recordings are calibrated.
        holdout: flights kept out of every fit, to confirm what is found.
        aircraft: a built-in name or a file; by default what the flights carry.
        simulation: your own simulation as base, such as jsbsim:c172p.
        effects: files with effects of your own.
        seed: of every random draw.
        nulls: simulated flights of the base model, from which thresholds come.
        progress: called with a sentence on the present step, and the share done.

    Raises:
        UserError: one sentence, for what cannot be found, or flights that cannot feed the model.

    Example::

        answer = ss.gap("lateral", ["f0.mcap", "f1.mcap"], holdout=["f2.mcap"])
        print(answer.verdict, answer.effects)
    """
    from estimation.errors import GapError
    from estimation.gap.decision.conclusion import more_beside_what_records_show_wrong
    from estimation.gap.effects import catalogue, load_effects
    from estimation.gap.workflow import Options, run_gap
    from estimation.prepare.measured_cg import at_stated_cg
    from estimation.prepare.measured_mass import at_mean_mass
    from estimation.resolve import as_listed, resolve
    from estimation.simulation.base_model import Free

    files = tuple(Path(f) for f in effects)
    # loaded here so that mistakes in them are refused before a flight is read
    own_effects = {path: [e.name for e in load_effects(path)] for path in files}
    training = as_listed(flights)
    every_flight = [*training, *as_listed(holdout)]
    options = Options(seed=seed, nulls=nulls)
    report_progress = progress or (lambda what, share: None)

    def search(moving: "Model | None" = None) -> "tuple[ResolvedCall, tuple[Effect, ...], GapResult]":
        problem = resolve(every_flight, model, aircraft, simulation=simulation, free=Free.FACTORS, moving=moving)
        effect_list = catalogue(files, problem.model)
        fitted, held_out = problem.flights[: len(training)], problem.flights[len(training) :]
        return problem, effect_list, run_gap(problem.model, fitted, held_out, effect_list, options, report_progress)

    try:
        problem, effect_list, result = search()
        if simulation is not None and more_beside_what_records_show_wrong(result):
            problem, effect_list, result = search(result.model_after)
    except GapError as error:
        if not files:
            raise
        hint = "if it works without --effects, an effect of your own is not finite along these flights"
        raise GapError(f"{error}; {hint}") from error
    model_before, model_after = (at_stated_cg(at_mean_mass(m)) for m in (result.model_before, result.model_after))
    result = replace(result, model_before=model_before, model_after=model_after)
    notes = (*problem.notes, *untested_effects(own_effects, result))
    return GapAnswer(result, problem.flights, effect_list, seed, notes)


def untested_effects(own_effects: "Mapping[Path, Sequence[str]]", result: "GapResult") -> list[str]:
    """A sentence on each file with effects that were not tested, so that their absence is not taken for an answer.

    own_effects: file of the user's own effects -> their names.
    """
    not_separated = {c["effect"] for c in result.details["cannot_tell"]}
    tested = {*result.scores, *not_separated, *(s.effect for s in result.steps)}
    untested = {path: [n for n in names if n not in tested] for path, names in own_effects.items()}
    return [
        f"effects {path}: {', '.join(names)} not tested: a term needs a signal, coefficient or instrument that this model or "
        "these flights do not have, or it changes nothing"
        for path, names in untested.items()
        if names
    ]


@dataclass(frozen=True, repr=False)
class GapAnswer(Answer):
    """The answer of `gap`. result: of the workflow; flights: training, then held out; catalogue: effects that were looked for;
    notes: what a simulation holds constant, which mass was used, which of the user's effects were not tested."""

    result: "GapResult"
    flights: "tuple[Flight, ...]"
    catalogue: "tuple[Effect, ...]"
    seed: int
    notes: tuple[str, ...] = ()

    @property
    def verdict(self) -> str:
        """no_gap, gap_closed, gap_reduced, unknown_effect or cannot_tell."""
        return self.result.verdict.value

    @property
    def effects(self) -> tuple[str, ...]:
        """Names of the effects found, in the order in which they were added."""
        return tuple(step.effect for step in self.result.steps)

    @property
    def model(self) -> "Model":
        """The model with the effects found."""
        return self.result.model_after

    def with_models(self, folder: str | Path) -> "GapAnswer":
        """Write the models before and after, with their lineage, to a folder; returns the answer that names these files."""
        from estimation.gap.decision.lineage import with_models

        return replace(self, result=with_models(self.result, self.flights, self.seed, Path(folder)))

    def to_json(self) -> dict[str, Any]:
        return self.result.to_json()

    def to_pandas(self) -> "pd.DataFrame":
        """A row for each hypothesis of the catalogue, the highest score first; `named`: added to the model."""
        pd = optional("pandas", "a table of pandas")

        steps = {s.effect: s for s in self.result.steps}
        rows = [
            {
                "effect": n,
                "score": score,
                "threshold": steps[n].threshold if n in steps else self.result.threshold,
                "named": n in steps,
                "weight": steps[n].confidence if n in steps else float("nan"),
                "minimum_detectable": self.result.minimum_detectable.get(n, float("nan")),
            }
            for n, score in sorted(self.result.scores.items(), key=lambda pair: -pair[1])
        ]
        return pd.DataFrame(rows)

    def lines(self) -> list[str]:
        return [*self.notes, *_lines(self.result)]

    def plot(self, ax: Any = None) -> Any:
        """Draw the leading hypotheses with their scores and the threshold; returns the axes."""
        return plot_scores(self.result, ax)

    def figures(self) -> Figures:
        """The figures of the report: scores, where the disagreement lives, every flight before and after."""
        from estimation.gap.pages.report import gap_figures

        return Figures(gap_figures(self.result))

    def writers(self) -> Mapping[str, Callable[[Path], Any]]:
        """The model with the effects found as .toml, everything as .json, the table as .csv."""
        from estimation.models import write_model

        return {**super().writers(), ".toml": lambda path: write_model(self.model, path), **table_writers(self)}

    def report(self, folder: str | Path) -> Path:
        from estimation.gap.pages.report import write_gap_report

        return write_gap_report(self.result, Path(folder), self.catalogue)

    def headline(self) -> str:
        names = [" or ".join(m.effect for m in s.members) or s.effect for s in self.result.steps]
        return f"Gap: {self.verdict}{': ' if names else ''}{', '.join(names)}"

    def rows(self) -> Rows:
        """A row for each effect that was added."""
        rows = [(s.effect, s.title, f"{s.score:.1f}", f"{s.threshold:.2f}", s.gap.share) for s in self.result.steps]
        return ("effect", "", "score", "threshold", "closed"), rows

    def _repr_html_(self) -> str:
        return html_table(f"{self.headline()}. {self.result.text}", *self.rows())


def _lines(result: "GapResult") -> list[str]:
    """The printed lines."""
    lines = [f"verdict: {result.verdict.value}", result.text]
    if result.steps:
        lines.append("")
        lines.append(
            f"{'effect':20s} {'score':>7s} {'threshold':>9s} {'weight':>7s}  {'gap before':>10s} {'after':>7s} "
            f"{'floor':>7s} {'training':>8s} {'held out':>9s}"
        )
    for s in result.steps:
        holdout = "-" if s.holdout is None else s.holdout.share
        lines.append(
            f"{s.effect:20s} {s.score:7.1f} {s.threshold:9.2f} {s.confidence:7.2f}  {s.gap.before:10.3f} {s.gap.after:7.3f} "
            f"{s.gap.floor:7.3f} {s.gap.share:>8s} {holdout:>9s}"
        )
    if any(s.holdout is not None for s in result.steps):
        lines.append(
            "training, held out: share of the gap closed on the flights fitted and on those held out, which decide"
        )
    parameters = result.model_before.parameters
    from_simulation = {p.name: p for p in parameters if p.reference_source.startswith("simulation")}
    for step in result.steps:
        for name, (value, _) in step.estimates.items():
            if name in from_simulation:
                parameter = from_simulation[name]
                lines.append(
                    f"{name}: the {parameter.reference_source} has {parameter.reference:.4g}, the flights {value:.4g}"
                )
    if beside := beside_simulation(result.model_after):
        lines.append(beside)
    if result.files[1]:
        lines.append(f"model: {result.files[0]} -> {result.files[1]}")
    return lines


def beside_simulation(model: "Model") -> str:
    """A sentence on the parameters that are estimated beside a simulation in any case: they are no gap, and an error of its
    zero-lift drag shows nowhere else. Empty for a model without a simulation."""
    from estimation.simulation.base_model import SHARE

    coefficients = [n.removesuffix("_sim") for n in model.definitions if n.endswith("_sim")]
    names = {SHARE, *(name for c in coefficients for name in (f"{c}_0", f"k_{c}"))} if coefficients else {}
    estimated = [
        f"{p.name} {p.start:.3g} ({p.reference:g})"
        for p in model.parameters
        if p.name in names and not p.fixed and p.reference is not None
    ]
    return "estimated beside the simulation, whose values are in brackets: " + ", ".join(estimated) if estimated else ""
