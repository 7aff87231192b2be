"""`estimate`: aerodynamic parameters of flights, with bounds."""

from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

from daq.contract.plain_words import comma_separated
from estimation.answers.answer import Answer, Rows, picture_writers, rounded
from estimation.answers.notebook import Figures, plot_estimates
from estimation.threads import single_threaded

if TYPE_CHECKING:
    import pandas as pd

    from estimation.estimators.result import Result
    from estimation.models import Model
    from estimation.resolve import AnyAircraft, AnyModel, Flights, Names
    from estimation.session.session import EstimationSession


@single_threaded
def estimate(
    flights: "Flights",
    model: "AnyModel" = "lateral",
    method: "Names" = "ml",
    *,
    aircraft: "AnyAircraft" = None,
    simulation: str | None = None,
    joint: bool = False,
    device: str = "cpu",
    segments: str | None = None,
    each_segment: bool = False,
    raw_inputs: bool = False,
    keep_held: bool = False,
    hold_initial: "Names" = "",
    free_initial: "Names" = "",
    stepwise: bool = False,
    truth: "str | Path | Mapping[str, float] | None" = None,
    profile: "Names" = "",
    bootstrap: int = 0,
    structure: str = "test",
    seed: int = 0,
    progress: Callable[[str], None] | None = None,
) -> "Estimates":
    """Aerodynamic parameters with bounds. Arguments are the options of the verb; names are comma-separated or a list.

    simulation: one of your own as base; then model is a built-in name or a model file found on a simulation. truth: true
    derivatives by name, or the JSON file of them. structure: off, test or auto, for what the model may
    lack. progress: told each piece of work as it begins. Raises a UserError of one
    sentence for what cannot be found, or flights that cannot feed the model.
    """
    from estimation.estimators.estimator import Extras
    from estimation.resolve import resolve
    from estimation.session import runner
    from estimation.session.structured import StructureWish
    from estimation.session.truth import read_truth
    from estimation.simulation.base_model import Free

    problem = resolve(
        flights, model, aircraft, method, segments=segments, each_segment=each_segment, simulation=simulation,
        free=Free.DERIVATIVES, hold_initial=hold_initial, free_initial=free_initial,
    )  # fmt: skip
    names = [f.name for f in problem.flights]
    true = dict(truth) if isinstance(truth, Mapping) else {} if truth is None else read_truth(Path(truth), names)
    extras = Extras(comma_separated(profile), bootstrap, seed, raw_inputs, stepwise, keep_held)
    session = runner.estimate(
        problem.model, problem.flights, problem.aircraft, problem.methods, joint=joint, device=device, progress=progress,
        extras=extras, structure=StructureWish.of(structure),
    )  # fmt: skip
    return Estimates(replace(session, truth=true), problem.notes)


@dataclass(frozen=True, repr=False)
class Estimates(Answer):
    """What `estimate` found. session: the whole of it; notes: what of a simulation is held."""

    session: "EstimationSession"
    notes: tuple[str, ...] = ()

    @property
    def best(self) -> "Result":
        """The joint estimate where there is one, else that of the first flight; of the first method."""
        return next(iter((self.session.joint or self.session.flights[0].results).values()))

    @property
    def model(self) -> "Model":
        """The model with the estimates as its values, and the ranges it was estimated from."""
        from estimation.session.flown import flown

        used = [f.flight for f in (self.session.flights if self.session.joint else self.session.flights[:1])]
        return replace(self.best.fitted_model, flown=flown(self.best.model, used))

    @property
    def passed(self) -> bool:
        """Whether every method converged on every flight."""
        return self.session.converged

    def __getitem__(self, parameter: str) -> Any:
        """Estimate, bounds and verdict of one parameter of `best`."""
        return self.best.parameters[parameter]

    def to_json(self) -> dict[str, Any]:
        """As `estimate --json` has it."""
        return self.session.to_json()

    def to_pandas(self) -> "pd.DataFrame":
        """A row for each flight (and "joint"), method and parameter; estimates are per rad, angles in rad."""
        import pandas as pd

        per_flight = [(f.flight.name, f.results) for f in self.session.flights]
        joint = [("joint", self.session.joint)] if self.session.joint else []
        rows = [
            {
                "flight": flight,
                "method": method,
                "parameter": name,
                "estimate": e.estimate,
                "std": e.std,
                "std_coloured": e.std_coloured,
                "identifiable": e.identifiable,
                "unit": e.unit,
                "reference": e.reference,
                "why": e.why,
            }
            for flight, results in (*per_flight, *joint)
            for method, result in results.items()
            for name, e in result.parameters.items()
        ]
        return pd.DataFrame(rows)

    def lines(self, *, brief: bool = False) -> Iterator[str]:
        """What `sideslip estimate` prints; brief: a line for each flight."""
        from estimation.answers.estimate_lines import session_lines

        yield from (f"simulation: {note}" for note in self.notes)
        yield from session_lines(self.session, brief=brief)

    def plot(self, ax: Any = None) -> Any:
        """Every derivative of `best` relative to its size, with the corrected bound; gives the axes."""
        return plot_estimates(self.best, ax)

    def figures(self) -> Figures:
        """The figures of the report: derivatives over flights, histories, residuals, proof of match, ellipses."""
        from estimation.report.estimate_page import estimate_figures

        return Figures(estimate_figures(self.session))

    def report(self, folder: str | Path) -> Path:
        """Write the HTML report; gives its page."""
        from estimation.report.estimate_page import write_estimate_report

        return write_estimate_report(self.session, Path(folder))

    def write_histories(self, folder: Path) -> list[Path]:
        """Write each flight with what the model shows beside it; gives the files."""
        from estimation.report.drawing.histories import write_flights

        return write_flights(self.session, folder)

    def writers(self) -> Mapping[str, Callable[[Path], Any]]:
        """The model as .toml, everything as .json, the table as .csv or .tex, measured and estimated histories as a picture."""
        from estimation.models import write_model
        from estimation.report.drawing.histories import write_histories
        from estimation.report.model_export import export_estimates

        def write_table(path: Path) -> None:
            export_estimates(self.to_json(), path)

        return {
            **super().writers(),
            ".toml": lambda path: write_model(self.model, path),
            ".csv": write_table,
            ".tex": write_table,
            **picture_writers(lambda path: write_histories(self.session, path)),
        }

    def headline(self) -> str:
        """Model, methods and how it went."""
        return f"Estimates of {self.session.model.name} by {', '.join(self.session.methods)}: {self.session.text:.300}"

    def rows(self) -> Rows:
        """A row for each parameter of `best`."""
        rows = [
            (n, *rounded(e), "" if e.reference is None else f"{e.reference:.4g}", e.why)
            for n, e in self.best.parameters.items()
        ]
        return ("parameter", "estimate", "corrected bound", "before", ""), rows
