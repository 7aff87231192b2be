"""`estimate`: aerodynamic parameters of flights with bounds, and their printed tables."""

from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

from daq.utilities.packages import optional
from daq.utilities.plain_words import comma_separated, did_you_mean
from estimation.answers.answer import Answer, Figures, Rows, panels, picture_writers, rounded_texts
from estimation.errors import UnknownNameError
from estimation.threads import single_threaded

if TYPE_CHECKING:
    import pandas as pd

    from estimation.estimators.result import Bootstrap, Result
    from estimation.models import Model
    from estimation.resolve import AnyAircraft, AnyModel, Flights, Names
    from estimation.session.session import EstimationSession
    from estimation.session.verdict import Verdict


def session_lines(session: "EstimationSession", *, brief: bool = False) -> Iterator[str]:
    """The printed answer: verdict, derivatives and advice; then a table for each flight and method, mean and scatter, joint
    estimates, and conventions. brief: one line for each flight, without the first part and the conventions."""
    from estimation.report.answer import answer_lines
    from estimation.report.conventions import conventions_lines

    if brief:
        yield f"aircraft {session.aircraft.name}, model {session.model.name}"
    else:
        yield from answer_lines(session)
    for f in session.flights:
        for method, result in f.results.items():
            if brief:
                yield f"{f.flight.name} ({len(f.flight)} samples), {method}: {result.text}"
                yield f"  {brief_numbers(result)}"
                continue
            yield ""
            yield f"{f.flight.name} ({len(f.flight)} samples), {method}: {result.text}"
            yield from result_lines(result)
        for method, reason in f.failures.items():
            yield f"{f.flight.name}, {method}: {reason}"
        for note in () if brief else f.notes:
            yield f"  note: {note}"
        yield from _verdict_lines(f.verdict, brief=brief)
    if len(session.flights) > 1:
        yield from _mean_lines(session)
    for method, result in session.joint.items():
        yield ""
        yield f"joint over {len(session.flights)} flights, {method}: {result.text}"
        yield from result_lines(result)
    for method, reason in session.joint_failures.items():
        yield f"joint over {len(session.flights)} flights, {method}: {reason}"
    yield from _verdict_lines(session.verdict, brief=False)
    if not brief:
        yield ""
        yield f"aircraft {session.aircraft.name}, model {session.model.name}"
        yield from conventions_lines(session)


def _verdict_lines(verdict: "Verdict | None", *, brief: bool) -> Iterator[str]:
    """Doubts, and the recommended method."""
    if verdict is None:
        return
    for doubt in () if brief else verdict.doubts:
        yield f"  doubt ({doubt.kind.value}): {doubt.text}"
    yield f"  recommended: {verdict.recommended.text}"


def brief_numbers(result: "Result") -> str:
    """All identifiable estimates with their corrected bounds in one line, rounded to the second figure of the bound."""
    from estimation.report.tables import rounded

    identifiable = [(n, rounded(e.estimate, e.std_coloured)) for n, e in result.parameters.items() if e.identifiable]
    return "  ".join(f"{n} {value}" + (f" ({bound})" if bound else "") for n, (value, bound) in identifiable)


def result_lines(result: "Result") -> Iterator[str]:
    """Estimate, Cramer-Rao bound, corrected bound and prior belief, parameter by parameter; then the fit."""
    yield f"  {'parameter':<12}{'estimate':>11}{'bound':>10}{'corrected':>11}{'before':>10}"
    for name, e in result.parameters.items():
        reference = "" if e.reference is None else f"{e.reference:10.4g} {e.reference_source}"
        reason = "" if e.identifiable else f"  cannot tell: {e.why}"
        yield f"  {name:<12}{e.estimate:11.4g}{e.std:10.2g}{e.std_coloured:11.2g}{reference}{reason}"
    for flight in result.flights:
        line = "  ".join(f"{n} {f.r2:.3f}" for n, f in flight.fit.items())
        yield f"  fit r2{' ' + flight.name if len(result.flights) > 1 else ''}: {line}"
    for first, second, rho in result.collinear[:4]:
        yield f"  correlated: {first} and {second}, {rho:+.3f}"
    for name, p in result.profile.items():
        if p.values.size:
            (low, high), (wide_low, wide_high) = p.interval, p.interval_coloured
            yield f"  profile {name}: 95 % {low:.4g} .. {high:.4g}, corrected {wide_low:.4g} .. {wide_high:.4g}"
        if p.text:
            yield f"  profile {name}: {p.text}"
    if result.bootstrap is not None:
        yield from _bootstrap_lines(result.bootstrap)


def _bootstrap_lines(b: "Bootstrap") -> Iterator[str]:
    if b.text:
        yield f"  bootstrap: {b.text}"
        return
    yield f"  bootstrap, {len(b.estimates)} replicates" + (f", {b.failed} more could not be fitted" if b.failed else "")
    yield f"  {'parameter':<12}{'spread':>11}{'bias':>10}  95 % interval"
    for name, s in b.parameters.items():
        yield f"  {name:<12}{s.std:11.2g}{s.bias:10.1g}  {s.interval[0]:.4g} .. {s.interval[1]:.4g}"


def _mean_lines(session: "EstimationSession") -> Iterator[str]:
    for method, table in session.mean.items():
        yield ""
        yield f"mean over flights, {method}"
        heading = f"{'truth':>11}" if session.truth else ""
        yield f"  {'parameter':<12}{'mean':>11}{'scatter':>10}{'corrected':>11}{'flights':>9}{heading}"
        for name, s in table.items():
            true = f"{session.truth[name]:11.4g}" if name in session.truth else " " * len(heading)
            scatter = f"{s.std:.2g}" if s.count > 1 else "-"  # of one flight there is none
            yield f"  {name:<12}{s.mean:11.4g}{scatter:>10}{s.bound:11.2g}{s.count:9d}{true}  {s.text}".rstrip()


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
    """Aerodynamic parameters with bounds: what `sideslip estimate` gives.

    Args:
        flights: a Flight, a file, or a list of them; raw recordings are calibrated.
        model: "lateral", "lateral-simple", "longitudinal", "six-dof", a model file, "module:Class" or a Model.
        method: "ml", "fem", "fem-noise", "ml-frequency", "ngn", "ngn-improved", "ls", "live"; several with commas or as
            a list.
        aircraft: a built-in name or a file; by default what the flights carry.
        simulation: your own simulation as base; the model is then a built-in name or a model file found on a simulation.
        joint: also one estimate over all flights.
        device: of the networks: cpu or cuda.
        segments: use only these stretches: "1:9,12:20" [s], "mode:FBWA", "V > 12".
        each_segment: each segment as a flight.
        raw_inputs: measured inputs with their noise, to compare with another program.
        keep_held: take repeated values of slow and stuck sensors for measurements.
        hold_initial: states whose initial values are held.
        free_initial: states whose initial values are estimated.
        stepwise: `ls` keeps only significant terms.
        truth: true derivatives by name, or the JSON file of them.
        profile: parameters with an interval by profile likelihood.
        bootstrap: number of refits.
        structure: what the model may lack: "off", "test" or "auto".
        seed: of bootstrap and networks.
        progress: called with each piece of work as it begins.

    Raises:
        UserError: one sentence, for what cannot be found, or flights that cannot feed the model.

    Returns Estimates: `answer["Cl_p"].estimate` [1/rad] with `.std_coloured`, its bound of one standard deviation.

    Example::

        result = ss.estimate("ld1.mcap", "lateral", "ml")
        print(result.summary())
    """
    from estimation.answers.truth import read_truth
    from estimation.estimators.estimator import Extras
    from estimation.resolve import resolve
    from estimation.session import runner
    from estimation.session.structured import StructureWish
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
    """The answer of `estimate`. session: all results; notes: what a simulation holds constant, which mass was used."""

    session: "EstimationSession"
    notes: tuple[str, ...] = ()

    @property
    def best(self) -> "Result":
        """The joint estimate where there is one, else that of the first flight; of the first method."""
        return next(iter((self.session.joint or self.session.flights[0].results).values()))

    @property
    def model(self) -> "Model":
        """The model with the estimates as its values, and the ranges and stretches it was estimated from."""
        from estimation.prepare.measured_cg import at_stated_cg
        from estimation.prepare.measured_mass import at_mean_mass
        from estimation.session.proof_of_match import flown_ranges, stretches_of_recordings

        flights = [f.flight for f in (self.session.flights if self.session.joint else self.session.flights[:1])]
        ranges, stretches = flown_ranges(self.best.model, flights), stretches_of_recordings(flights)
        return replace(at_stated_cg(at_mean_mass(self.best.fitted_model)), flown=ranges, estimated_from=stretches)

    @property
    def passed(self) -> bool:
        """Whether every method converged on every flight."""
        return self.session.converged

    def __getitem__(self, parameter: str) -> Any:
        """The Estimate of one parameter of `best`. Raises UnknownNameError, a KeyError, which suggests a similar name."""
        parameters = self.best.parameters
        if parameter not in parameters:
            near = did_you_mean(parameter, parameters) or f"; it has {', '.join(parameters)}"
            raise UnknownNameError(f"no parameter {parameter!r} in these estimates{near}")
        return parameters[parameter]

    def to_json(self) -> dict[str, Any]:
        """The content of `estimate --json`: the session, the conventions of its numbers, and the priors that entered the fit."""
        from estimation.report.conventions import conventions, priors

        more = {"conventions": dict(conventions(self.session)), "priors": priors(self.session)}
        return {**self.session.to_json(), **more}

    def to_pandas(self) -> "pd.DataFrame":
        """A row for each flight (and "joint"), method and parameter; estimates are per rad, angles in rad."""
        pd = optional("pandas", "a table of pandas")

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
        """The lines that `sideslip estimate` prints; brief: one line for each flight."""
        yield from self.notes
        yield from session_lines(self.session, brief=brief)

    def plot(self, ax: Any = None) -> Any:
        """Draw every derivative with its 95 % interval and its belief, relative to the estimate [%]; returns the axes."""
        from estimation.report.answer import leading_answer
        from estimation.report.drawing.forest import ROW, draw_forest

        rows = leading_answer(self.session).rows
        (ax,) = panels(ax, 1, (7.0, ROW * len(rows) + 1.2))
        return draw_forest(ax, rows)

    def figures(self) -> Figures:
        """The figures of the report: derivatives over flights, histories, residuals, proof of match, ellipses."""
        from estimation.report.estimate_page import estimate_figures

        return Figures(estimate_figures(self.session))

    def report(self, folder: str | Path) -> Path:
        """Write the HTML report; returns its page."""
        from estimation.report.estimate_page import write_estimate_report

        return write_estimate_report(self.session, Path(folder))

    def write_histories(self, folder: Path) -> list[Path]:
        """Write each flight with the model's outputs beside the measured ones; returns the files."""
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
        return f"Estimates of {self.session.model.name} by {', '.join(self.session.methods)}: {self.session.text:.300}"

    def rows(self) -> Rows:
        """A row for each parameter of `best`."""
        rows = [
            (n, *rounded_texts(e), "" if e.reference is None else f"{e.reference:.4g}", e.why)
            for n, e in self.best.parameters.items()
        ]
        return ("parameter", "estimate", "corrected bound", "before", ""), rows
