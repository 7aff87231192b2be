"""The few functions the equations of motion need, for one flight (floats) or many (arrays of shape (flights,)).

The physics is written once. One flight runs on Python floats, some ten times faster than on arrays of length one; many
flights run on rows of shape (flights,), where the cost of a numpy call is shared by all of them.
"""

import math
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import numpy as np

# A quantity of one flight (float) or of many (array of shape (flights,)).
Value = Any
# State, by index: list of floats, or array of shape (states, flights).
State = Any


def _clip_float(x: float, low: float, high: float) -> float:
    return low if x < low else high if x > high else x


def _sign_float(x: float) -> float:
    return 1.0 if x > 0.0 else -1.0 if x < 0.0 else 0.0


def _clip_array(x: Value, low: Value, high: Value) -> Value:
    return np.minimum(np.maximum(x, low), high)


def _select_float(condition: bool, yes: float, no: float) -> float:
    return yes if condition else no


@dataclass(frozen=True)
class Maths:
    """Elementary functions over one kind of Value."""

    flights: int | None  # None: floats
    sin: Callable[[Value], Value]
    cos: Callable[[Value], Value]
    sqrt: Callable[[Value], Value]
    exp: Callable[[Value], Value]
    tanh: Callable[[Value], Value]
    asin: Callable[[Value], Value]
    atan2: Callable[[Value, Value], Value]
    clip: Callable[[Value, Value, Value], Value]
    sign: Callable[[Value], Value]
    select: Callable[[Any, Value, Value], Value]
    maximum: Callable[[Value, Value], Value]

    def new_state(self, size: int) -> State:
        """A state of `size` zeros."""
        return [0.0] * size if self.flights is None else np.zeros((size, self.flights))

    def full(self, value: Value) -> Value:
        """`value` as a Value of this kind."""
        return (
            float(value) if self.flights is None else np.broadcast_to(np.asarray(value, float), (self.flights,)).copy()
        )

    def advance(self, x: State, step: Value, slope: State) -> State:
        """x + step * slope."""
        if self.flights is None:
            return [a + step * b for a, b in zip(x, slope, strict=True)]
        return x + step * slope


FLOATS = Maths(
    flights=None,
    sin=math.sin,
    cos=math.cos,
    sqrt=math.sqrt,
    exp=math.exp,
    tanh=math.tanh,
    asin=math.asin,
    atan2=math.atan2,
    clip=_clip_float,
    sign=_sign_float,
    select=_select_float,
    maximum=max,
)


def array_maths(flights: int) -> Maths:
    """Elementary functions over arrays of shape (flights,)."""
    return Maths(
        flights=flights,
        sin=np.sin,
        cos=np.cos,
        sqrt=np.sqrt,
        exp=np.exp,
        tanh=np.tanh,
        asin=np.arcsin,
        atan2=np.arctan2,
        clip=_clip_array,
        sign=np.sign,
        select=np.where,
        maximum=np.maximum,
    )
