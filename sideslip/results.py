"""What the functions of `sideslip.api` give: data that prints shortly, shows a table in a notebook, and gives pandas frames,
figures, pages and files when asked.
"""

from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

from daq.contract.durable import whole
from sideslip.notebook import Figures, plot_estimates, plot_proof, plot_reconstructed, plot_scores, table

if TYPE_CHECKING:
    import pandas as pd

    from estimation.compatibility.result import Compatibility
    from estimation.estimators.result import Result
    from estimation.gap.answer.result import GapResult
    from estimation.models import Model
    from estimation.session.proof_of_match import Proof
    from estimation.session.session import Session
    from groundstation.flight import Flight
    from groundstation.flight.quality.report import Finding

__all__ = ["Check", "Estimates", "GapAnswer", "Match"]


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
        """Every derivative of `best` relative to its size, with the corrected bound; gives the axes."""
        return plot_estimates(self.best, ax)

    def figures(self) -> Figures:
        """The figures of the report: derivatives over flights, histories, residuals, proof of match, ellipses."""
        from estimation.report.page import estimate_figures

        return Figures(estimate_figures(self.session))

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
            (n, *_rounded(e), "" if e.reference is None else f"{e.reference:.4g}", e.why)
            for n, e in self.best.parameters.items()
        ]
        return table(repr(self), ("parameter", "estimate", "corrected bound", "before", ""), rows)


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

    def plot(self, ax: Any = None) -> Any:
        """Measured and reconstructed motion of the first flight, one axes a channel; gives the axes."""
        return plot_reconstructed(next(iter(self.results.values())).flights[0], ax)

    def figures(self) -> Figures:
        """The figures of the page that `check --report` writes."""
        from functools import partial

        from estimation.report.check_page import motion_figure, motion_pairs

        pairs = motion_pairs([self.results[f.name].flights[0] for f in self.flights])
        return Figures({f"figure7_{i + 1}": partial(motion_figure, pair, i) for i, pair in enumerate(pairs)})

    def report(self, folder: str | Path) -> Path:
        """Write the HTML report; gives its page."""
        from estimation.report.check_page import write_check_report

        quality = [self.quality[f.name] for f in self.flights]
        return write_check_report(self.flights, quality, list(self.results.items()), Path(folder))

    def save(self, path: str | Path) -> Path:
        """Write the table of factors as .csv; gives the path."""
        return _csv(self.to_pandas(), path)

    def __repr__(self) -> str:
        worst = {v for findings in self.quality.values() for v in (f.verdict for f in findings)}
        verdict = next((v for v in ("fail", "warn", "ok") if v in worst), "ok")
        return f"<Check of {', '.join(self.quality)}: {verdict}>"

    def _repr_html_(self) -> str:
        rows = [
            (flight, n, *_rounded(f), f.unit)
            for flight, result in self.results.items()
            for n, f in result.factors.items()
        ]
        return table(repr(self), ("flight", "factor", "estimate", "corrected bound", "unit"), rows)


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

    def summary(self) -> str:
        """The table that `sideslip match` prints."""
        from estimation.commands.match import proof_lines
        from estimation.signals.goodness_of_fit import THEIL_LIMIT

        return "\n".join(line for p in self.proofs for line in proof_lines(p, THEIL_LIMIT))

    def plot(self, ax: Any = None) -> Any:
        """Measured and predicted outputs of the first flight, one axes a channel; gives the axes."""
        return plot_proof(self.proofs[0], ax)

    def figures(self) -> Figures:
        """Figure 10 of the report pages."""
        from functools import partial

        from estimation.report.drawing.estimate_figures import proof_figure

        whose = self.proofs[0].result.model.name
        drawn = partial(proof_figure, [(whose, p) for p in self.proofs], "initial states", of_paper=False)
        return Figures({"figure10": drawn})

    def save(self, path: str | Path) -> Path:
        """Write the table as .csv; gives the path."""
        return _csv(self.to_pandas(), path)

    def __repr__(self) -> str:
        worst = max((f.theil for p in self.proofs for f in p.fit.values()), default=float("nan"))
        return f"<Match of {', '.join(p.name for p in self.proofs)}: largest Theil coefficient {worst:.3f}>"

    def _repr_html_(self) -> str:
        rows = [
            (p.name, n, f"{f.r2:.3f}", f"{f.theil:.3f}", f"{f.rms:.3g}") for p in self.proofs for n, f in p.fit.items()
        ]
        return table(repr(self), ("flight", "channel", "r2", "Theil", "rms"), rows)


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

    def to_pandas(self) -> "pd.DataFrame":
        """A row for each hypothesis of the catalogue, the highest score first; `named`: added to the model."""
        import pandas as pd

        named = {s.effect: s for s in self.result.steps}
        rows = [
            {
                "effect": n,
                "score": score,
                "threshold": named[n].threshold if n in named else self.result.threshold,
                "named": n in named,
                "weight": named[n].confidence if n in named else float("nan"),
                "minimum_detectable": self.result.minimum_detectable.get(n, float("nan")),
            }
            for n, score in sorted(self.result.scores.items(), key=lambda pair: -pair[1])
        ]
        return pd.DataFrame(rows)

    def summary(self) -> str:
        """What `sideslip gap` prints."""
        from estimation.commands.gap import lines

        return "\n".join(lines(self.result))

    def plot(self, ax: Any = None) -> Any:
        """The leading hypotheses with their scores and the threshold; gives the axes."""
        return plot_scores(self.result, ax)

    def figures(self) -> Figures:
        """The figures of the report: scores, where the disagreement lives, every flight before and after."""
        from estimation.gap.pages.report import gap_figures

        return Figures(gap_figures(self.result))

    def save(self, path: str | Path) -> Path:
        """Write .toml (the model with what was found), .json (everything) or .csv (the table)."""
        from daq.contract.outputs import write_json
        from estimation.models import write_model

        path = Path(path)
        if path.suffix == ".toml":
            write_model(self.model, path)
        elif path.suffix == ".json":
            write_json(self.result.to_json(), path)
        else:
            _csv(self.to_pandas(), path)
        return path

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
        return table(f"{repr(self).strip('<>')}. {self.result.text}", head, rows)


def _csv(frame: "pd.DataFrame", path: str | Path) -> Path:
    """Write a table. Raises UserError for another ending."""
    from daq.contract.errors import UserError

    path = Path(path)
    if path.suffix.lower() != ".csv":
        raise UserError(f"{path}: no known format of this table; end the name in .csv")
    with whole(path) as new:
        frame.to_csv(new, index=False)
    return path


def _rounded(found: Any) -> tuple[str, str]:
    """Estimate and corrected bound to the second figure of the bound."""
    from estimation.report.tables import rounded

    return rounded(found.estimate, found.std_coloured)
