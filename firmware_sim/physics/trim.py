"""Straight and level flight: the angle of attack, elevator and thrust that hold a speed."""

from dataclasses import dataclass
from typing import TYPE_CHECKING

from daq.utilities.constants import GRAVITY
from firmware_sim.physics.atmosphere import air_at
from firmware_sim.physics.maths import Value

if TYPE_CHECKING:
    from firmware_sim.physics.plant import Plant


@dataclass(frozen=True, slots=True)
class Trim:
    """Level trim: alpha [rad] (= theta), elevator [rad], thrust [N], at `speed` [m/s] and `height` [m above the field]."""

    speed: Value
    height: Value
    alpha: Value
    elevator: Value
    thrust: Value


def level_trim(plant: "Plant", speed: Value, height: Value) -> Trim:
    """Solve lift + thrust = weight, drag = thrust and zero pitching moment for wings-level flight.

    The elevator follows from the moment at each angle of attack; the angle of attack by fixed-point iteration, which
    contracts by the small ratio of thrust to lift.
    """
    xp, d = plant.xp, plant.derivatives
    air = air_at(plant.site.elevation_m + height, plant.site.temperature_offset_k)
    force = 0.5 * air.density * speed * speed * plant.aircraft.area
    weight = plant.mass * GRAVITY
    alpha = xp.full(0.1)
    # Elevator for zero moment is affine in alpha: lift slope with the elevator following.
    slope = d["CL_alpha"] - d["CL_de"] * d["Cm_alpha"] / d["Cm_de"]
    at_zero = d["CL_0"] - d["CL_de"] * d["Cm_0"] / d["Cm_de"]
    thrust = xp.full(0.0)
    for _ in range(60):
        lift = (weight - thrust * xp.sin(alpha)) / force
        alpha = (lift - at_zero) / slope
        thrust = force * (d["CD_0"] + d["CD_k"] * lift * lift) / xp.cos(alpha)
    elevator = -(d["Cm_0"] + d["Cm_alpha"] * alpha) / d["Cm_de"]
    return Trim(speed, height, alpha, elevator, thrust)
