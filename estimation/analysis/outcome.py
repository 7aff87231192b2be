"""The answer of an analysis: a verdict in one sentence, the numbers behind it, and next steps."""

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from markupsafe import Markup

from estimation.answers.answer import Answer, Rows
from estimation.report.tables import value_and_bound

SHOWN = 10
"""Derivatives in the verdict."""
ROUGH = 0.25
"""Bound over value from which on a derivative is reported as roughly known: too wide for a design."""


@dataclass(frozen=True, repr=False)
class Analysis(Answer):
    """content: of `answer.json`. pages: title -> path from the folder. repeated: stages that this run did."""

    content: Mapping[str, Any]
    pages: Mapping[str, str]
    repeated: tuple[str, ...]

    def to_json(self) -> dict[str, Any]:
        return dict(self.content)

    @property
    def passed(self) -> bool:
        """Whether an estimate is recommended, and no contradiction stops it."""
        stopped = any(c.get("stops") for c in self.content["contradictions"])
        return recommendation_of(self.content["estimate"]).get("method", "none") != "none" and not stopped

    def headline(self) -> str:
        return str(self.content["verdict"])

    def lines(self) -> Iterator[str]:
        yield self.headline()
        yield from (f"  contradiction in {c['flight']}: {c['text']}" for c in self.content["contradictions"])
        for name, value, bound, reason in self.derivatives():
            yield f"  {name:<12}{value:>11} +- {bound:<10}{reason}".rstrip()
        yield from (f"  next: {n}" for n in self.content["next"])

    def derivatives(self) -> list[tuple[str, str, str, str]]:
        """Name, estimate, corrected bound and reason for doubt, by the recommended method, else the first."""
        rows = []
        for name, p in parameters_of(self.content["estimate"]).items():
            if p.get("estimate") is not None:
                value, bound = value_and_bound(p["estimate"], p["std_coloured"])
                rough = roughly(p) if is_coefficient(name) else 0.0
                reason = f"known to {rough:.0%} only" if rough else ""
                rows.append((name, value, bound, reason if p.get("identifiable") else str(p.get("why", "cannot tell"))))
        return rows

    def rows(self) -> Rows:
        """The derivatives."""
        return ("parameter", "estimate", "corrected bound", ""), self.derivatives()

    def plot(self, ax: Any = None) -> Any:
        """Derivatives relative to their size, with the corrected bound; gives the axes."""
        from estimation.answers.answer import panels

        (axes,) = panels(ax, 1)
        identifiable = {n: p for n, p in parameters_of(self.content["estimate"]).items() if p.get("identifiable")}
        sizes = [abs(p["estimate"]) or 1.0 for p in identifiable.values()]
        axes.errorbar(
            range(len(identifiable)),
            [p["estimate"] / s for p, s in zip(identifiable.values(), sizes, strict=True)],
            [p["std_coloured"] / s for p, s in zip(identifiable.values(), sizes, strict=True)],
            fmt="o",
        )
        axes.set_xticks(range(len(identifiable)), list(identifiable), rotation=90)
        return axes

    def report(self, folder: str | Path) -> Path:
        """Write the page whose first screen is the answer; gives its path."""
        from estimation.report.page import Page, Section, box, bullets, paragraph
        from estimation.report.tables import ReportTable

        c = self.content
        head, rows = self.rows()
        derivatives = ReportTable("derivatives", "Derivatives", tuple(head), tuple(map(tuple, rows)))
        spans = ("from [s]", "to [s]")
        stretches = ReportTable(
            "stretches", "Stretches used", ("flight", "by", *spans), _spans(c["stretches"], "by"), symbols=False
        )
        modes = ReportTable(
            "modes", "Flight modes of the log", ("flight", "mode", *spans), _spans(c["modes"], "mode"), symbols=False
        )
        origin = ("channel", "from", "kind", "rate [Hz]")
        channels = ReportTable("channels", "Where each channel comes from", origin, _channels(c), symbols=False)
        without = c.get("without_aircraft") or {}
        answer = "Answer" if self.passed else "Answer: not to be used as it is"
        twice = "What the log says twice, and differently"
        contradictions = [_contradiction(found) for found in c["contradictions"]]
        sections = [
            Section("answer", answer, [box([paragraph(c["verdict"])])], "Answer"),
            Section("next", "Next", [bullets(c["next"])]) if c["next"] else None,
            Section("contradictions", twice, [bullets(contradictions)]) if contradictions else None,
            Section("", "", [derivatives if rows else None]),
            Section("gap", "What the model lacks", [box([paragraph(c["gap"]["text"])])]) if c["gap"] else None,
            Section("without", "Without an aircraft file", [bullets(without["lines"])]) if without else None,
            Section("used", "Stretches", [stretches], "Stretches") if stretches.rows else None,
            Section("", "", [t for t in (modes, channels) if t.rows]),
            Section("notes", "Notes", [bullets(c["notes"])]) if c["notes"] else None,
            Section("", "", [paragraph(Markup('The same for a program: <a href="answer.json">answer.json</a>.'))]),
        ]
        title = f"Analysis of {', '.join(f['name'] for f in c['flights'])}"
        links = [(href, name) for name, href in self.pages.items()]
        return Page(title, "", sections, links).write(Path(folder) / "index.html")


def _spans(entries: Sequence[Mapping[str, Any]], key: str) -> tuple[tuple[str, ...], ...]:
    return tuple((e["flight"], e[key], f"{e['from']:.2f}", f"{e['to']:.2f}") for e in entries)


def is_coefficient(name: str) -> bool:
    """Whether a parameter is a derivative of an aerodynamic coefficient: no constant, and no lag or scale of a sensor."""
    return name.startswith("C") and not name.endswith("_0")


def roughly(parameter: Mapping[str, Any]) -> float:
    """Bound over value of an estimate where that is above ROUGH, else 0. parameter: as in the JSON of `estimate`."""
    value, bound = parameter.get("estimate"), parameter.get("std_coloured")
    share = abs(bound / value) if parameter.get("identifiable") and value and bound else 0.0
    return share if share > ROUGH else 0.0


def _contradiction(found: Mapping[str, Any]) -> str:
    moves = f" (moves {found['moves']})" if found["moves"] else ""
    return f"{found['flight']}: {found['text']}{moves}"


def _channels(content: Mapping[str, Any]) -> tuple[tuple[str, ...], ...]:
    rows = []
    for flight in content["flights"]:
        for name, channel in flight["channels"].items():
            rate = channel.get("rate_hz")
            kind = f"{channel.get('kind', '')}{', a command' if channel.get('held') else ''}"
            rows.append(
                (name, str(channel.get("from", "")), kind, f"{rate:.3g}" if isinstance(rate, int | float) else "")
            )
    return tuple(rows)


def recommendation_of(estimate: Mapping[str, Any] | None) -> Mapping[str, Any]:
    """The recommendation for all flights together, else for the first."""
    if not estimate:
        return {}
    recommendation = estimate.get("recommended") or next(
        (f.get("recommended") for f in estimate.get("flights", [])), None
    )
    return recommendation if isinstance(recommendation, Mapping) else {}


def parameters_of(estimate: Mapping[str, Any] | None) -> Mapping[str, Mapping[str, Any]]:
    """Parameters by the recommended method, else the first; of the joint estimate where there is one."""
    if not estimate:
        return {}
    methods: Mapping[str, Any] = estimate.get("joint") or next((f["methods"] for f in estimate.get("flights", [])), {})
    method = recommendation_of(estimate).get("method", "none")
    first: Mapping[str, Any] = next(iter(methods.values()), {})
    return dict((methods.get(method) or first).get("parameters", {}))


def verdict_of(estimate: Mapping[str, Any], place: str, contradictions: Sequence[Mapping[str, Any]]) -> str:
    """The recommended derivatives in one sentence, or why none are recommended. place: which stretches were used."""
    recommendation = recommendation_of(estimate)
    method = recommendation.get("method", "none")
    model, aircraft = estimate.get("model", ""), estimate.get("aircraft", "")
    stopping = [c["text"] for c in contradictions if c.get("stops")]
    if method == "none":
        why = str(recommendation.get("why") or estimate.get("status", "")) or "; ".join(stopping)
        return f"No derivatives of {aircraft} are recommended ({model} {place}): {why}"
    values = [
        f"{n} {' +- '.join(value_and_bound(p['estimate'], p['std_coloured']))}"
        for n, p in parameters_of(estimate).items()
        if p.get("identifiable") and not n.endswith("_0")
    ]
    rest = f" and {len(values) - SHOWN} more" if len(values) > SHOWN else ""
    text = f"Derivatives of {aircraft} by {method} ({model} {place}): {', '.join(values[:SHOWN])}{rest}"
    return f"{text}; but the log contradicts itself: {'; '.join(stopping)}" if stopping else text
