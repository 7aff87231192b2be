"""Hypotheses, candidates, screens and rounds made by hand, as much of each as the rules of the search look at."""

from collections.abc import Sequence
from types import SimpleNamespace
from typing import Any

import numpy as np

from estimation.engine.kernel import Array
from estimation.gap.criteria import AS_SET
from estimation.gap.effects.base import Effect, EffectParameter, Form, Group
from estimation.gap.search.confirm import FittedHypothesis
from estimation.gap.significance.calibration import Round
from estimation.gap.significance.omnibus import Omnibus, OmnibusSignal, Remainder
from estimation.gap.significance.screen import Hypothesis, HypothesisColumn, Screen
from estimation.models.base import InputTransform, Model, Parameter
from estimation.models.base import Signal as Variable

BASE = Model("none", (Variable("p"),), (), (Variable("p"),), (Parameter("a"),), ("p_dot = a*p",))


def stub(**fields: Any) -> Any:
    """As much of a round, problem or setting as a rule looks at."""
    return SimpleNamespace(**fields)


def hypothesis(name: str, kind: str = "linear", forms: int = 1) -> Hypothesis:
    """One unknown of usual size 2, between -10 and 10; kind: linear, delay or backlash."""
    parameter = EffectParameter(name, "s", 2.0, -10.0, 10.0)
    transforms = () if kind == "linear" else (InputTransform(kind, "delta_a", (name,)),)
    made = tuple(Form(f"{name}{i or ''}", (parameter,), transforms=transforms) for i in range(forms))
    effect = Effect(name, name, Group.ACTUATOR, "", "", "", "", {}, "fly it", made)
    return Hypothesis(effect, made[0])


def candidate(name: str = "x", kind: str = "linear", **known: Any) -> FittedHypothesis:
    given: dict[str, Any] = {
        "gain": 100.0,
        "score": 10.0,
        "evidence": 50.0,
        "estimates": {},
        "size": 1.0,
        "why_not": "",
    }
    return FittedHypothesis(hypothesis(name, kind), fitted_with("delta_a"), **(given | known))


def fitted_with(*controls: str) -> Any:
    """A fit of a model of these controls."""
    model = stub(inputs=[Variable(n, control=True) for n in controls])
    return stub(values={}, residuals=(), diverged=False, model=model)


def screen(hypotheses: Sequence[Hypothesis], gram: Array | None = None, flights: tuple[int, ...] = (0,)) -> Screen:
    """Every hypothesis with one column of unit length; the last column of `gram` is the residual."""
    k = len(hypotheses)
    columns = tuple(HypothesisColumn(h, x.form.parameters[0]) for h, x in enumerate(hypotheses))
    whole = np.eye(k + 1) if gram is None else gram
    return Screen((), tuple(hypotheses), columns, (whole,) * len(flights), np.zeros_like(whole), flights)


def round_by_hand(**known: Any) -> Any:
    """A round that its nulls decide."""
    made = stub(threshold=4.0, has_enough_nulls=True, **known)
    made.with_enough_nulls = made
    return made


ROUND = round_by_hand(baseline="base", criteria=AS_SET, tangent=stub(forget=lambda: None))
REST = Omnibus(
    9.0, 5.0, (OmnibusSignal("term", "r", "beta", 9.0, gain=80.0), OmnibusSignal("time", "r", "burst", 8.0, gain=1e9))
)


def remainder(round_: Round, most: float = 80.0) -> Remainder:
    """With REST for an answer, and `most` before the controls are measured again."""
    rest = Remainder(round_)
    vars(rest).update(omnibus=REST, _terms=([OmnibusSignal("term", "r", "beta", 9.0, gain=most)], None))
    return rest
