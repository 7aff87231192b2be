"""Rigid bodies put together: mass, centre and inertia of several links, and what is left of a whole."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from estimation.simulation.oracle import Array


@dataclass(frozen=True)
class Body:
    """mass [kg], centre (3,) [m], inertia (3, 3) about the centre [kg m2], all along the same axes."""

    mass: float
    centre: Array
    inertia: Array

    def about(self, point: Array) -> Array:
        """(3, 3) inertia about a point."""
        d = self.centre - point
        return np.asarray(self.inertia + self.mass * (np.dot(d, d) * np.eye(3) - np.outer(d, d)))


def together(bodies: Sequence[Body]) -> Body:
    """All bodies as one."""
    mass = sum(b.mass for b in bodies)
    centre = np.asarray(sum(b.mass * b.centre for b in bodies)) / mass
    return Body(mass, centre, np.asarray(sum(b.about(centre) for b in bodies)))


def rest_of(whole: Body, parts: Sequence[Body]) -> Body:
    """What has to be added to the parts so that they are the whole."""
    mass = whole.mass - sum(b.mass for b in parts)
    moment = whole.mass * whole.centre - sum(b.mass * b.centre for b in parts)
    centre = np.asarray(moment / mass)
    point = Body(mass, centre, np.zeros((3, 3)))
    inertia = whole.inertia - sum(b.about(whole.centre) for b in parts) - point.about(whole.centre)
    return Body(mass, centre, np.asarray(inertia))


def turned(roll: float, pitch: float, yaw: float) -> Array:
    """(3, 3) rotation of a pose: from its axes to those it stands in, fixed-axis roll, pitch, yaw [rad]."""
    (cr, sr), (cp, sp), (cy, sy) = ((np.cos(a), np.sin(a)) for a in (roll, pitch, yaw))
    return np.array([
        [cy * cp, cy * sp * sr - sy * cr, cy * sp * cr + sy * sr],
        [sy * cp, sy * sp * sr + cy * cr, sy * sp * cr - cy * sr],
        [-sp, cp * sr, cp * cr],
    ])  # fmt: skip
