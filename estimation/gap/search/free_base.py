"""A base that holds its derivatives at numbers, several of which are off: it is refitted in all of them before anything is asked.

A simulation of one's own has its derivatives from a handbook or a wind tunnel. One that is wrong is an answer, and gets its
name; of many that are off by some per cent each none is what the flights miss, and together they hide what is: of a T-37 with 14
lateral derivatives off by up to 10 % nothing was found where a `Cn_beta3` was hidden.
"""

from collections.abc import Mapping, Sequence

from estimation.gap.criteria import Criteria
from estimation.gap.effects.base import Group
from estimation.gap.fit.baseline import Baseline
from estimation.gap.search.state import Setting
from estimation.gap.significance.screen import Projected, build_screen, hypotheses_for
from estimation.gap.significance.tangent import Tangent
from estimation.models.base import Model

FACTOR = "k_"  # of a coefficient of a simulation: its derivatives, all free, say the same


def derivatives_off(setting: Setting, baseline: Baseline) -> tuple[str, ...]:
    """The derivatives that a fitted base holds at numbers and the flights move, where several of them are off; none otherwise."""
    held = [e for e in setting.effects if e.group is Group.DERIVATIVE and any(f.frees for f in e.forms)]
    hypotheses = hypotheses_for(baseline.clean, held, setting.prepared.available)
    if len(hypotheses) < baseline.criteria.many_derivatives:
        return ()
    screen = build_screen(Tangent(baseline.problem, baseline.fit), hypotheses)
    if len(one_after_another(screen.projected(), baseline.criteria)) < baseline.criteria.many_derivatives:
        return ()
    return tuple(n for h in screen.hypotheses for n in h.form.frees)


def one_after_another(projected: Projected, criteria: Criteria) -> list[int]:
    """Columns that gain beside those before them, the largest gain first, as far as that decides whether many do."""
    chosen: list[int] = []
    while len(chosen) < criteria.many_derivatives:
        known = projected.gain(chosen) if chosen else 0.0
        gains = {j: projected.gain([*chosen, j]) - known for j in range(len(projected.B)) if j not in chosen}
        best = max(gains, key=lambda j: gains[j], default=-1)
        if best < 0 or gains[best] <= criteria.exchange:
            break
        chosen.append(best)
    return chosen


def with_free_derivatives(model: Model, names: Sequence[str]) -> Model:
    """A base with derivatives free, and the factors on its coefficients held."""
    factors = [
        n for n in model.free_names if n.startswith(FACTOR) and f"{n.removeprefix(FACTOR)}_sim" in model.definitions
    ]
    return model.freed(*names).fixed(*factors)


def moved_in_words(names: Sequence[str], before: Mapping[str, float], baseline: Baseline) -> str:
    """A sentence on the derivatives that were set free and moved by more than their bounds allow."""
    std, values = baseline.fit.std(), baseline.fit.values
    far = baseline.criteria.migrated_bounds
    moved = [n for n in names if abs(values[n] - before[n]) > far * std[n]]
    words = ", ".join(f"{n} from {before[n]:.4g} to {values[n]:.4g} +- {std[n]:.2g}" for n in moved)
    return f"Several derivatives of the base are off, so that all {len(names)} were refitted first: {words or 'none moved far'}."
