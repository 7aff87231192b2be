"""The gap report: one self-contained HTML page that tells the story to a flight-test engineer."""

import re
from pathlib import Path
from typing import Any

import numpy as np
from jinja2 import Environment

from daq.contract.plain_words import printed
from estimation.gap.answer.result import GapResult, Histories
from estimation.gap.pages.residual_maps import png, residual_maps

PAGE = Path(__file__).with_name("report.html.j2")
TITLES = {
    "no_gap": "No gap", "gap_closed": "Gap found and closed", "gap_reduced": "Gap found and reduced",
    "unknown_effect": "A gap nothing in the catalogue explains", "cannot_tell": "These flights cannot tell",
}  # fmt: skip


def write_gap_report(result: GapResult, folder: Path) -> Path:
    """Write `folder`/index.html and return its path; pictures are inside the page."""
    from markupsafe import Markup

    def gap(g: Any) -> Markup:
        cells = (f"{g.before:.3f}", f"{g.after:.3f}", f"{g.floor:.3f}", f"{g.closed:.0%}")
        return Markup("".join(f'<td class="n">{c}</td>' for c in cells))

    def typeset(equation: str) -> Markup:
        """C_nβ and the like with their subscripts lowered."""
        return Markup(re.sub(r"_([^\s_()|*+−=,;/]+)", r"<sub>\1</sub>", str(Markup.escape(equation))))

    page = Environment(autoescape=True, finalize=printed).from_string(PAGE.read_text(encoding="utf-8")).render(
        r=result, title=TITLES[result.verdict.value], gap=gap, typeset=typeset, gate=result.details["kinematic_gate"],
        pictures=[(f"{h.flight}{' (held out)' if h.holdout else ''}", _history(h, result.outputs)) for h in result.histories],
        bars=_bars(result), places=residual_maps(result) if result.views else "", cannot=result.details["cannot_tell"],
    )  # fmt: skip
    folder.mkdir(parents=True, exist_ok=True)
    path = folder / "index.html"
    path.write_text(page, encoding="utf-8")
    return path


def _history(h: Histories, outputs: tuple[str, ...]) -> str:
    from matplotlib.figure import Figure

    figure = Figure(figsize=(11, 1.7 * len(outputs)), layout="constrained")
    axes = figure.subplots(len(outputs), 2, sharex=True, squeeze=False)
    for c, name in enumerate(outputs):
        unit, k = ("m/s²", 1.0) if name.startswith("a") and len(name) == 2 else ("deg", 180 / np.pi)
        left, right = axes[c]
        left.plot(h.time, k * h.measured[:, c], ".", ms=2, color="#8899a6", label="measured")
        left.plot(h.time, k * h.before[:, c], lw=0.9, color="#c8553d", label="before")
        left.plot(h.time, k * h.after[:, c], lw=0.9, color="#2a6f97", label="after")
        left.set_ylabel(f"{name} [{unit}{'/s' if name in 'pqr' else ''}]")
        right.axhspan(-k * h.floor[c], k * h.floor[c], color="#dfe8ee", label="floor ±1σ")
        right.plot(h.time, k * (h.measured - h.before)[:, c], lw=0.6, color="#c8553d")
        right.plot(h.time, k * (h.measured - h.after)[:, c], lw=0.6, color="#2a6f97")
    axes[0][0].legend(fontsize=7, ncols=3)
    axes[0][1].legend(fontsize=7)
    axes[0][0].set_title("measured and model", fontsize=9)
    axes[0][1].set_title("residuals", fontsize=9)
    for axis in axes[-1]:
        axis.set_xlabel("time [s]")
    return png(figure)


def _bars(result: GapResult) -> str:
    from matplotlib.figure import Figure

    names = list(result.scores)
    figure = Figure(figsize=(9, 0.2 * len(names) + 1), layout="constrained")
    axis = figure.subplots()
    named = {s.effect for s in result.steps}
    colours = ["#2a6f97" if n in named else "#b8c4cc" for n in names]
    axis.barh(range(len(names)), [max(result.scores[n], 1e-3) for n in names], color=colours)
    axis.set_yticks(range(len(names)), names, fontsize=7)
    axis.invert_yaxis()
    axis.axvline(result.threshold, color="#c8553d", lw=1, label=f"null threshold {result.threshold:.2f}")
    axis.set_xlabel("score in units of its scatter on the nulls")
    axis.legend(fontsize=8)
    return png(figure)
