"""The smallest aircraft: one that only rolls."""

from estimation.models.base import Model, Parameter, Signal

ROLL = Model(
    name="roll",
    states=(Signal("p", "rad/s"),),
    inputs=(Signal("delta_a", "rad", control=True),),
    outputs=(Signal("p", "rad/s"),),
    parameters=(Parameter("L_p", start=-6.0), Parameter("L_a", start=40.0)),
    equations=("p_dot = L_p*p + L_a*delta_a",),
)
