"""Sideslip in a notebook: five lines from a recording to derivatives with bounds.

    import sideslip as ss
    flight = ss.open("ld1.mcap")
    result = ss.estimate(flight, "lateral")
    result.to_pandas()
    result.plot()

Every function does what the verb of its name does, with the same numbers; what it returns prints shortly, shows a table in a
notebook, and gives pandas frames, figures and files when asked.
"""

import html
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    import pandas as pd

    from estimation.aircraft import Aircraft
    from estimation.compatibility.result import Compatibility
    from estimation.design.design import Design
    from estimation.estimators.result import Result
    from estimation.gap.answer.result import GapResult
    from estimation.models import Model
    from estimation.session.proof_of_match import Proof
    from estimation.session.session import Session
    from groundstation.flight import Flight
    from groundstation.flight.quality import Finding

    Flights = Flight | str | Path | Sequence[Flight | str | Path]
    AnyModel = str | Path | Model | type
    AnyAircraft = str | Path | Aircraft | None


def open(path: str | Path) -> "Flight":
    """A flight file (.mcap, .csv, .parquet), or a raw recording, calibrated with the set it carries."""
    from groundstation.export.run import open_flight

    return open_flight(Path(path))


def import_log(path: str | Path, mapping: str | Path | None = None, rate_hz: float | None = None) -> "Flight":
    """Somebody else's log as a flight: CSV, Parquet, ULog, ArduPilot .bin, .tlog; mapping: a file as for `import --map`."""
    from groundstation.importers.run import import_data

    return import_data(Path(path), None if mapping is None else Path(mapping), rate_hz=rate_hz)


def check(flights: "Flights", factors: Sequence[str] = (), joint: bool = False) -> "Check":
    """Data compatibility and quality; factors: as for `check --factors`, the standard ones where none is given."""
    from estimation.compatibility.reconstruction import compatibility
    from estimation.models.kinematic import STANDARD_FACTORS
    from estimation.session.flights import unique_names
    from groundstation.flight.quality import quality_report

    read = unique_names(_read(flights))
    wanted = tuple(factors) or STANDARD_FACTORS
    results = {flight.name: compatibility(flight, wanted) for flight in read}
    if joint:
        results["joint"] = compatibility(read, wanted)
    return Check(results, {flight.name: tuple(quality_report(flight)) for flight in read}, tuple(read))


def estimate(
    flights: "Flights",
    model: "AnyModel" = "lateral",
    method: str | Sequence[str] = "ml",
    *,
    aircraft: "AnyAircraft" = None,
    joint: bool = False,
    seed: int = 0,
) -> "Estimates":
    """Aerodynamic parameters with bounds; method: names as for `estimate --method`, comma-separated or a list."""
    from estimation.estimators.estimator import Extras
    from estimation.session import runner
    from estimation.session.flights import unique_names

    read = unique_names(_read(flights))
    chosen, craft = _model(model, read, aircraft)
    methods = [m.strip() for m in method.split(",")] if isinstance(method, str) else list(method)
    session = runner.estimate(chosen, read, craft, methods, joint=joint, extras=Extras(seed=seed))
    return Estimates(session)


def match(
    model: "AnyModel", flights: "Flights", free: Sequence[str] = (), *, aircraft: "AnyAircraft" = None
) -> "Match":
    """Predict flights with the model's parameters frozen, but those named in `free`."""
    from estimation.session.flights import unique_names
    from estimation.session.proof_of_match import predict

    read = unique_names(_read(flights))
    chosen, _ = _model(model, read, aircraft)
    return Match(tuple(predict(chosen, flight, free=tuple(free)) for flight in read))


def gap(
    model: "AnyModel",
    flights: "Flights",
    holdout: "Flights" = (),
    *,
    aircraft: "AnyAircraft" = None,
    seed: int = 1,
    nulls: int = 200,
) -> "GapAnswer":
    """Find what the model of the flights is missing; holdout: flights kept out of every fit."""
    from estimation.gap.workflow import Options, run_gap

    training, held = _read(flights), _read(holdout)
    chosen, _ = _model(model, [*training, *held], aircraft)
    return GapAnswer(run_gap(chosen, training, held, options=Options(seed=seed, nulls=nulls)))


def design(
    model: "AnyModel", time: float, aircraft: "str | Path | Aircraft", kind: str = "optimal", **task: Any
) -> "Design":
    """An input of `time` seconds that tells most; further arguments are those of `estimation.design.design.Task`."""
    import math

    from estimation.design.design import Task
    from estimation.design.design import design as designed

    chosen, craft = _model(model, [], aircraft)
    density = task.setdefault("density", 1.17)
    task.setdefault("speed", math.sqrt(2 * craft.mass * 9.80665 / (density * craft.area * 0.3)))
    return designed(chosen, craft, Task(kind, time, **task))


def simulate(model: "AnyModel", flight: "Flight | str | Path", *, aircraft: "AnyAircraft" = None) -> "Flight":
    """The flight with what the model shows on its measured inputs, as columns `<output>_model`."""
    from estimation.engine.simulate import simulate as simulated

    (read,) = _read(flight)
    chosen, _ = _model(model, [read], aircraft)
    y = simulated(chosen, read)
    return read.with_columns(**{f"{name}_model": y[:, i] for i, name in enumerate(chosen.output_names)})


def _read(flights: "Flights") -> "list[Flight]":
    from groundstation.flight import Flight

    listed = [flights] if isinstance(flights, Flight | str | Path) else list(flights)
    return [f if isinstance(f, Flight) else open(f) for f in listed]


def _model(which: "AnyModel", flights: "Sequence[Flight]", aircraft: "AnyAircraft") -> "tuple[Model, Aircraft]":
    """The model, and the aircraft it is of: the given one, the one the flights carry or name, else unknown where it may be."""
    from estimation.aircraft import Aircraft, unknown_aircraft
    from estimation.aircraft.of_flight import aircraft_of
    from estimation.models import load_model
    from estimation.models.load import asks_for_aircraft

    if isinstance(aircraft, Aircraft):
        return load_model(which, aircraft), aircraft
    if aircraft is None and not (isinstance(which, str | Path) and asks_for_aircraft(str(which))):
        craft = unknown_aircraft(flights[0].provenance.aircraft if flights else "not stated")
        return load_model(which, None), craft
    craft = aircraft_of(flights, aircraft)
    return load_model(which, craft), craft


# --------------------------------------------------------------------------------------------------------- results


@dataclass(frozen=True, repr=False)
class Estimates:
    """What `estimate` found. `session` is the whole of it."""

    session: "Session"

    @property
    def best(self) -> "Result":
        """The joint estimate where there is one, else that of the first flight; of the first method."""
        joint = self.session.leading
        return joint if joint is not None else next(iter(self.session.flights[0].results.values()))

    @property
    def model(self) -> "Model":
        """The model with the estimates as its values."""
        return self.best.fitted_model

    def __getitem__(self, parameter: str) -> Any:
        """Estimate, bounds and verdict of one parameter of `best`."""
        return self.best.parameters[parameter]

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

    def summary(self) -> str:
        """The table that `sideslip estimate` prints."""
        from estimation.commands.estimate import session_lines

        return "\n".join(session_lines(self.session))

    def plot(self, ax: Any = None) -> Any:
        """Every derivative of `best` relative to its size, with the corrected bound; gives the axes.

        The figures of the report: `report(folder)`.
        """
        from matplotlib import pyplot as plt

        if ax is None:
            _, ax = plt.subplots(figsize=(7.0, 3.2), layout="constrained")
        told = {n: e for n, e in self.best.parameters.items() if e.identifiable and not n.endswith("_0")}
        size = {n: abs(e.reference) if e.reference else abs(e.estimate) for n, e in told.items()}
        at = range(len(told))
        values = [e.estimate / size[n] for n, e in told.items()]
        ax.errorbar(at, values, [e.std_coloured / size[n] for n, e in told.items()], fmt="o", capsize=3)
        ax.set_xticks(list(at), list(told), rotation=60)
        ax.set_ylabel("estimate / belief")
        return ax

    def report(self, folder: str | Path) -> Path:
        """Write the HTML report; gives its page."""
        from estimation.report.page import write_estimate_report

        return write_estimate_report(self.session, Path(folder))

    def save(self, path: str | Path) -> Path:
        """Write .toml (the model), .json (everything), .csv or .tex (the table)."""
        from daq.contract.outputs import write_json
        from estimation.models import write_model
        from estimation.report.model_export import export_estimates

        path = Path(path)
        if path.suffix == ".toml":
            write_model(self.model, path)
        elif path.suffix == ".json":
            write_json(self.session.to_json(), path)
        else:
            export_estimates(self.session.to_json(), path)
        return path

    def __repr__(self) -> str:
        methods = ", ".join(self.session.methods)
        return f"<Estimates of {self.session.model.name} by {methods}: {self.session.text:.300}>"

    def _repr_html_(self) -> str:
        rows = [
            (
                n,
                f"{e.estimate:.5g}",
                f"{e.std_coloured:.2g}",
                "" if e.reference is None else f"{e.reference:.4g}",
                e.why,
            )
            for n, e in self.best.parameters.items()
        ]
        return _table(repr(self), ("parameter", "estimate", "corrected bound", "before", ""), rows)


@dataclass(frozen=True, repr=False)
class Check:
    """What `check` found. results: by flight (and "joint"); quality: findings by flight."""

    results: "Mapping[str, Compatibility]"
    quality: "Mapping[str, tuple[Finding, ...]]"
    flights: "tuple[Flight, ...]"

    def to_pandas(self) -> "pd.DataFrame":
        """A row for each flight and instrument factor."""
        import pandas as pd

        rows = [
            {"flight": flight, "factor": n, "estimate": f.estimate, "std": f.std, "std_coloured": f.std_coloured,
             "unit": f.unit, "identifiable": f.identifiable, "why": f.why}
            for flight, result in self.results.items()
            for n, f in result.factors.items()
        ]  # fmt: skip
        return pd.DataFrame(rows)

    def corrected(self) -> "list[Flight]":
        """The flights with the instrument factors taken out."""
        from estimation.compatibility.correct import corrected

        return [corrected(flight, self.results[flight.name]) for flight in self.flights]

    def summary(self) -> str:
        """Factors and findings, as `sideslip check` prints them."""
        from estimation.report.compatibility_tables import factor_lines

        told = list(factor_lines(list(self.results.items())))
        for name, findings in self.quality.items():
            told += ["", f"quality of {name}", *(f"  {f.verdict:<5}{f.check}: {f.text}" for f in findings)]
        return "\n".join(told)

    def __repr__(self) -> str:
        worst = {v for findings in self.quality.values() for v in (f.verdict for f in findings)}
        verdict = next((v for v in ("fail", "warn", "ok") if v in worst), "ok")
        return f"<Check of {', '.join(self.quality)}: {verdict}>"

    def _repr_html_(self) -> str:
        rows = [
            (flight, n, f"{f.estimate:.4g}", f"{f.std_coloured:.2g}", f.unit)
            for flight, result in self.results.items()
            for n, f in result.factors.items()
        ]
        return _table(repr(self), ("flight", "factor", "estimate", "corrected bound", "unit"), rows)


@dataclass(frozen=True, repr=False)
class Match:
    """Proofs of match, one for each flight."""

    proofs: "tuple[Proof, ...]"

    def to_pandas(self) -> "pd.DataFrame":
        """A row for each flight and channel: coefficient of determination, Theil's coefficient, rms."""
        import pandas as pd

        rows = [
            {"flight": p.name, "channel": n, "r2": f.r2, "theil": f.theil, "rms": f.rms, "whiteness": f.whiteness}
            for p in self.proofs
            for n, f in p.fit.items()
        ]
        return pd.DataFrame(rows)

    def __repr__(self) -> str:
        worst = max((f.theil for p in self.proofs for f in p.fit.values()), default=float("nan"))
        return f"<Match of {', '.join(p.name for p in self.proofs)}: largest Theil coefficient {worst:.3f}>"

    def _repr_html_(self) -> str:
        rows = [
            (p.name, n, f"{f.r2:.3f}", f"{f.theil:.3f}", f"{f.rms:.3g}") for p in self.proofs for n, f in p.fit.items()
        ]
        return _table(repr(self), ("flight", "channel", "r2", "Theil", "rms"), rows)


@dataclass(frozen=True, repr=False)
class GapAnswer:
    """What the gap workflow answers. `result` is the whole of it."""

    result: "GapResult"

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
        """The model with what was found."""
        return self.result.model_after

    def report(self, folder: str | Path) -> Path:
        """Write the HTML page; gives its path."""
        from estimation.gap.pages.report import write_gap_report

        return write_gap_report(self.result, Path(folder))

    def __repr__(self) -> str:
        return f"<Gap: {self.verdict}{': ' if self.effects else ''}{', '.join(self.effects)}>"

    def _repr_html_(self) -> str:
        rows = [
            (s.effect, s.title, f"{s.score:.1f}", f"{s.threshold:.2f}", f"{s.gap.closed:.0%}")
            for s in self.result.steps
        ]
        head = ("effect", "", "score", "threshold", "closed")
        return _table(f"{repr(self).strip('<>')}. {self.result.text}", head, rows)


def _table(title: str, head: Sequence[str], rows: Iterable[Sequence[str]]) -> str:
    """A small HTML table; all text is escaped."""
    heads = "".join(f"<th>{html.escape(h)}</th>" for h in head)
    body = "".join("<tr>" + "".join(f"<td>{html.escape(str(c))}</td>" for c in row) + "</tr>" for row in rows)
    shown = html.escape(title.strip("<>"))
    return f"<div><p>{shown}</p><table><thead><tr>{heads}</tr></thead><tbody>{body}</tbody></table></div>"
