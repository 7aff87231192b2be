"""The gap report: one self-contained HTML page that tells the story to a flight-test engineer."""

import base64
import io
from pathlib import Path
from typing import Any

import numpy as np
from jinja2 import Environment

from estimation.gap.result import GapResult, Histories

PAGE = """<!doctype html><html lang="en"><head><meta charset="utf-8"><title>Gap report</title><style>
body{font:15px/1.5 system-ui,sans-serif;max-width:62rem;margin:2rem auto;padding:0 1rem;color:#1c2733}
h1{font-size:1.6rem} h2{font-size:1.15rem;margin-top:2rem;border-bottom:1px solid #cfd8e0}
table{border-collapse:collapse;margin:.6rem 0} td,th{padding:.2rem .7rem;text-align:left;border-bottom:1px solid #e3e8ec}
td.n,th.n{text-align:right;font-variant-numeric:tabular-nums} img{max-width:100%} .verdict{background:#eef4f8;padding:.8rem 1rem;border-left:4px solid #2a6f97}
.eq{font:italic 17px Georgia,serif;padding:.4rem 1rem;background:#faf8f2} small{color:#5c6b78}</style></head><body>
<h1>{{ title }}</h1><p class="verdict">{{ r.text }}</p>
<p><small>{{ r.details.nulls }} simulated nulls, seed {{ r.details.seed }}; family-wise threshold {{ '%.2f'|format(r.threshold) }}
(nominal {{ '%.2f'|format(r.nominal_threshold) }}). Kinematic gate: {{ gate.origin }}{% if gate.best %} (best instrument error {{ gate.best }},
score {{ gate.score }} against {{ gate.threshold }}: {{ gate.why }}){% endif %}.</small></p>
{% for s in r.steps %}<h2>{{ loop.index }}. {{ s.title }} ({{ s.effect }})</h2>
{% if s.equation %}<p class="eq">{{ s.equation }}</p>{% endif %}<p>{{ s.text }}</p>
<table><tr><th></th><th class="n">before</th><th class="n">after</th><th class="n">floor</th><th class="n">closed</th></tr>
<tr><td>training flights</td>{{ gap(s.gap) }}</tr>{% if s.holdout %}<tr><td>held-out flights</td>{{ gap(s.holdout) }}</tr>{% endif %}</table>
<p>Where: {{ s.where.equation }}; channels {{ s.where.channels|join(', ') }}; {{ s.where.regime }}{% if s.where.segments %}; at
{% for a, b in s.where.segments %}{{ '%.1f'|format(a) }} to {{ '%.1f'|format(b) }} s{{ ', ' if not loop.last }}{% endfor %}{% endif %}.
{{ s.practical }}</p>
{% if s.members|length > 1 %}<table><tr><th>could be</th><th class="n">weight</th><th>what separates</th></tr>{% for m in s.members %}
<tr><td>{{ m.effect }}: {{ m.title }}</td><td class="n">{{ '%.2f'|format(m.weight) }}</td><td>{{ m.separate_by }}</td></tr>{% endfor %}</table>{% endif %}
{% if s.migrated %}<p>Derivatives that had absorbed it:</p><table><tr><th>derivative</th><th class="n">from</th><th class="n">to</th><th class="n">bounds</th></tr>
{% for n, m in s.migrated.items() %}<tr><td>{{ n }}</td><td class="n">{{ '%.4f'|format(m.before) }}</td><td class="n">{{ '%.4f'|format(m.after) }}</td>
<td class="n">{{ '%.1f'|format(m.bounds) }}</td></tr>{% endfor %}</table>{% endif %}{% endfor %}
<h2>Measured, before, after</h2>{% for name, picture in pictures %}<p><b>{{ name }}</b></p><img alt="{{ name }}" src="data:image/png;base64,{{ picture }}">{% endfor %}
<h2>All hypotheses</h2><img alt="scores" src="data:image/png;base64,{{ bars }}">
<h2>What these flights cannot tell apart</h2><table><tr><th>effect</th><th>effect</th><th class="n">|cos|</th></tr>{% for t in r.ties %}
<tr><td>{{ t.first }}</td><td>{{ t.second }}</td><td class="n">{{ '%.3f'|format(t.cosine) }}</td></tr>{% endfor %}</table>
{% if cannot %}<h2>Not visible on these flights; fly next</h2><table>{% for c in cannot %}<tr><td>{{ c.effect }}</td><td>{{ c.separate_by }}</td></tr>{% endfor %}</table>{% endif %}
{% if r.rejected %}<h2>Rejected, and why</h2><table>{% for x in r.rejected %}<tr><td>{{ x.effect }}</td><td>{{ x.why }}</td></tr>{% endfor %}</table>{% endif %}
<h2>Smallest size that would have been seen</h2><table>{% for n, v in r.minimum_detectable.items() %}<tr><td>{{ n }}</td><td class="n">{{ '%.3g'|format(v) }}</td></tr>{% endfor %}</table>
<h2>Lineage</h2><p>{{ r.model_before.name }} ({{ r.model_before.digest }}) &rarr; {{ r.model_after.name }} ({{ r.model_after.digest }})</p>
{% if r.notes %}<h2>Notes on the flights</h2><ul>{% for n in r.notes %}<li>{{ n }}</li>{% endfor %}</ul>{% endif %}</body></html>
"""
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

    page = Environment(autoescape=True).from_string(PAGE).render(
        r=result, title=TITLES[result.verdict.value], gap=gap, gate=result.details["kinematic_gate"],
        pictures=[(f"{h.flight}{' (held out)' if h.holdout else ''}", _history(h, result.outputs)) for h in result.histories],
        bars=_bars(result), cannot=result.details["cannot_tell"],
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
    return _png(figure)


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
    return _png(figure)


def _png(figure: Any) -> str:
    buffer = io.BytesIO()
    figure.savefig(buffer, format="png", dpi=90)
    return base64.b64encode(buffer.getvalue()).decode()
