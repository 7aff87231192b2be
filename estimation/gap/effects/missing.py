"""Effects made from the model itself: derivatives of the full linear model that it lacks or holds fixed."""

from estimation.gap.effects.base import Effect, EffectParameter, Form, Group
from estimation.models.base import Model

REGRESSORS = {"beta": "beta", "p": "p_hat", "r": "r_hat", "da": "delta_a", "dr": "delta_r"}
LONGITUDINAL_REGRESSORS = {"alpha": "alpha", "q": "q_hat", "de": "delta_e"}
WORDS = {
    "beta": "sideslip",
    "p": "roll rate",
    "r": "yaw rate",
    "da": "aileron",
    "dr": "rudder",
    "alpha": "angle of attack",
    "q": "pitch rate",
    "de": "elevator",
    "0": "constant part",
}
LINES = {"CY": "side force", "Cl": "rolling moment", "Cn": "yawing moment"}
LONGITUDINAL_LINES = {"CL": "lift", "Cm": "pitching moment"}
TYPICAL = {
    "CY_beta": 0.12, "CY_p": 0.05, "CY_r": 0.12, "CY_dr": 0.45, "Cl_beta": 0.09, "Cl_p": 0.45, "Cl_r": 0.10,
    "Cl_da": 0.10, "Cl_dr": 0.02, "Cn_beta": 0.025, "Cn_p": 0.02, "Cn_r": 0.04, "Cn_dr": 0.04,
    "CL_alpha": 3.0, "CL_q": 3.3, "CL_de": 1.0, "Cm_alpha": 0.17, "Cm_q": 0.9, "Cm_de": 0.36,
}  # fmt: skip
UNLISTED = 0.1  # usual size of a derivative that is not in TYPICAL
LARGEST = 12  # usual sizes to either side of its number: far outside any aircraft
SUBSCRIPT = {"beta": "β", "p": "p", "r": "r", "da": "δa", "dr": "δr", "alpha": "α", "q": "q", "de": "δe", "0": "0"}


def missing_derivatives(model: Model, known: set[str]) -> tuple[Effect, ...]:
    """One effect for each derivative that is no free parameter of `model`. known: names that the catalogue covers.

    A derivative held at a number counts too: the hypothesis is then that the number is wrong.
    """
    effects = []
    for lines, regressors in ((LINES, REGRESSORS), (LONGITUDINAL_LINES, LONGITUDINAL_REGRESSORS)):
        for line, quantity in lines.items():
            if line not in model.definitions:
                continue
            for suffix, regressor in regressors.items():
                name = f"{line}_{suffix}"
                if name not in known and name not in model.free_names:
                    effects.append(_effect(name, line, quantity, suffix, regressor, model))
    return tuple(effects)


def _effect(name: str, line: str, quantity: str, suffix: str, regressor: str, model: Model) -> Effect:
    is_fixed = name in model.parameter_names
    typical = TYPICAL.get(name, UNLISTED)
    start = model.parameter(name).start if is_fixed else 0.0
    lower, upper = start - LARGEST * typical, start + LARGEST * typical
    meaning = f"{quantity} per {WORDS[suffix]}"
    parameter = EffectParameter(name, "1/rad", typical, lower, upper, none=start, meaning=meaning)
    form = (
        Form(name, (parameter,), frees=(name,))
        if is_fixed
        else Form(name, (parameter,), terms={line: (f"{name}*{regressor}",)}, requires=(line, regressor))
    )
    return Effect(
        name=name,
        title=f"{quantity} due to {WORDS[suffix]}",
        group=Group.DERIVATIVE,
        physics=f"The model {'holds' if is_fixed else 'leaves out'} the {quantity} due to {WORDS[suffix]}"
        + (f" at {start:g}." if is_fixed else "."),
        equation=f"C_{line[1:]} = ... + C_{line[1:]}{SUBSCRIPT[suffix]} {regressor}",
        source="the linear model with all its derivatives",
        signature=f"residual in the {quantity}'s channel following {WORDS[suffix]}",
        confusions={},
        separate_by=f"a manoeuvre that moves {WORDS[suffix]} by itself",
        forms=(form,),
    )
