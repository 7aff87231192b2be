"""Linear roll and yaw, 22 parameters: measured sideslip as an input, accelerations among the outputs.

Run: sideslip estimate FLIGHT.csv --model docs.examples.roll_yaw:RollYaw
"""

from typing import Any, ClassVar

ROLL = ("L_0", "L_beta", "L_p", "L_r", "L_da", "L_dr", "L_betadot")
YAW = ("N_0", "N_beta", "N_p", "N_r", "N_da", "N_dr", "N_betadot")
SIDE = ("Y_0", "Y_beta", "Y_p", "Y_r", "Y_da", "Y_dr")
BIASES = ("bias_p_dot", "bias_r_dot")


class RollYaw:
    """Two states, five outputs, linear in everything."""

    states: ClassVar = {"p": "rad/s", "r": "rad/s"}
    inputs: ClassVar = {"beta": "rad", "delta_a": "rad", "delta_r": "rad", "beta_dot": "rad/s"}
    measured: ClassVar = {"p_dot": "rad/s2", "r_dot": "rad/s2", "ay": "m/s2", "p": "rad/s", "r": "rad/s"}
    parameters: ClassVar = {n: ("SI", -1.0 if n in ("L_p", "N_r") else 0.0) for n in (*ROLL, *YAW, *SIDE, *BIASES)}

    def derivatives(self, x: Any, u: Any, p: Any) -> list[Any]:
        return [self.linear(p, names, x, u) for names in (ROLL, YAW)]

    def outputs(self, x: Any, u: Any, p: Any, xdot: Any) -> list[Any]:
        ay = self.linear(p, SIDE, x, u)
        return [xdot.p + p.bias_p_dot, xdot.r + p.bias_r_dot, ay, x.p, x.r]

    def linear(self, p: Any, names: tuple[str, ...], x: Any, u: Any) -> Any:
        zero, *slopes = (p[name] for name in names)
        return zero + sum(
            a * b for a, b in zip(slopes, (u.beta, x.p, x.r, u.delta_a, u.delta_r, u.beta_dot), strict=False)
        )
