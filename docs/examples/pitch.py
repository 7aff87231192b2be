"""Nonlinear longitudinal motion: V, alpha, theta, q with a drag polar; thrust and dynamic pressure are inputs.

Run: sideslip estimate FLIGHT.csv --model docs.examples.pitch:Pitch --aircraft cdfp
"""

from typing import Any, ClassVar

from estimation.aircraft import Aircraft
from estimation.models.own import cos, sin


class Pitch:
    """Four states; lift, drag polar and pitching moment; dynamic pressure measured, not V squared."""

    states: ClassVar = {"V": "m/s", "alpha": "rad", "theta": "rad", "q": "rad/s"}
    inputs: ClassVar = {"delta_e": "rad", "thrust": "N", "p_dynamic": "Pa"}
    measured: ClassVar = {"V": "m/s", "alpha": "rad", "theta": "rad", "q": "rad/s", "ax": "m/s2", "az": "m/s2"}
    parameters: ClassVar = {
        "CL_0": "1", "CL_alpha": ("1/rad", 3.0), "CL_q": ("1/rad", 3.0), "CL_de": ("1/rad", 1.0), "CD_0": ("1", 0.03),
        "CD_k": ("1", 0.2), "Cm_0": "1", "Cm_alpha": ("1/rad", -0.2), "Cm_q": ("1/rad", -1.0), "Cm_de": ("1/rad", -0.3),
    }  # fmt: skip

    def __init__(self, aircraft: Aircraft) -> None:
        self.a = aircraft

    def coefficients(self, x: Any, u: Any, p: Any) -> tuple[Any, Any, Any]:
        q_hat = x.q * self.a.chord / (2 * x.V)
        lift = p.CL_0 + p.CL_alpha * x.alpha + p.CL_q * q_hat + p.CL_de * u.delta_e
        drag = p.CD_0 + p.CD_k * lift**2
        return lift, drag, p.Cm_0 + p.Cm_alpha * x.alpha + p.Cm_q * q_hat + p.Cm_de * u.delta_e

    def derivatives(self, x: Any, u: Any, p: Any) -> list[Any]:
        a, g, force = self.a, 9.80665, u.p_dynamic * self.a.area
        lift, drag, pitch = self.coefficients(x, u, p)
        climb = x.theta - x.alpha
        V_dot = (u.thrust * cos(x.alpha) - force * drag) / a.mass - g * sin(climb)
        alpha_dot = x.q - (force * lift + u.thrust * sin(x.alpha)) / (a.mass * x.V) + g / x.V * cos(climb)
        return [V_dot, alpha_dot, x.q, force * a.chord * pitch / a.Iyy]

    def outputs(self, x: Any, u: Any, p: Any, xdot: Any) -> list[Any]:
        force = u.p_dynamic * self.a.area / self.a.mass
        lift, drag, _ = self.coefficients(x, u, p)
        ax = force * (lift * sin(x.alpha) - drag * cos(x.alpha)) + u.thrust / self.a.mass
        return [x.V, x.alpha, x.theta, x.q, ax, -force * (lift * cos(x.alpha) + drag * sin(x.alpha))]
