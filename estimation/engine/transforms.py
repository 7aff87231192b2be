"""Input transforms by name: functions from a measured control to the input of the equations, such as a delay or backlash.

Each takes time (N,) s, the input (N,) and its parameter, and returns the input of the equations (N,) at the samples. Derivatives
by the parameters are central differences.
"""

from collections.abc import Callable, Collection, Mapping

import numpy as np

from estimation.engine.kernel import Array
from estimation.models.base import InputTransform
from estimation.signals.first_order import decaying_sum

SHORTEST_LAG = 1e-6  # s: a shorter lag is none


def _delay(time: Array, value: Array, seconds: float) -> Array:
    """u(t - T): transport delay [s], the first value before the record and the last after it.

    Cubic between samples (Keys, IEEE Trans. ASSP 29, 1981), so smooth in T. Straight lines would have a kink in T at zero and at
    every multiple of the interval, and a fit of a delay near zero would not settle.
    """
    if time.size < 2:
        return value.copy()
    step, rise = time[1:] - time[:-1], value[1:] - value[:-1]
    slope = np.zeros(value.size)  # of a parabola through a sample and its neighbours
    share = step[1:] / (step[:-1] + step[1:])
    slope[1:-1] = share * rise[:-1] / step[:-1] + (1.0 - share) * rise[1:] / step[1:]
    first, last = step * slope[:-1] - rise, rise - step * slope[1:]
    source = np.minimum(np.maximum(time - seconds, time[0]), time[-1])  # when the delayed value was measured
    i = np.minimum(np.searchsorted(time, source, "right") - 1, time.size - 2)
    s = (source - time.take(i)) / step.take(i)  # `take` is three times as fast as an index
    bend = (1.0 - s) * ((1.0 - s) * first.take(i) + s * last.take(i))
    return np.asarray(value.take(i) + s * (rise.take(i) + bend))


def _lag(time: Array, value: Array, seconds: float) -> Array:
    """T du'/dt + u' = u: first-order lag [s], exact for an input straight between samples, from equilibrium."""
    if seconds <= SHORTEST_LAG:
        return value.copy()
    h = np.diff(time)
    a = np.exp(-h / seconds)
    slope = np.diff(value) / h
    # exact response to a ramp: e' = -e/T with e = u' - (u - T slope)
    drive = value[1:] - seconds * slope - a * (value[:-1] - seconds * slope)
    return decaying_sum(np.concatenate([[0.0], a]), np.concatenate([value[:1], drive]))


def _deadzone(time: Array, value: Array, half_width: float) -> Array:
    """Dead zone: zero within +-half_width, shifted towards zero by half_width outside."""
    return np.sign(value) * np.maximum(np.abs(value) - abs(half_width), 0.0)


def _backlash(time: Array, value: Array, width: float) -> Array:
    """Play: the output follows only after the input has crossed the total play `width`; it starts centred."""
    half = 0.5 * abs(width)
    return _clamped(value - half, value + half, float(value[0]))


def _rate_limit(time: Array, value: Array, slowness: float) -> Array:
    """Rate limit: at most one unit in `slowness` seconds; no limit for 0 and below."""
    if slowness <= 0.0:
        return value.copy()
    result = np.empty_like(value)
    current = float(value[0])
    result[0] = current
    for k, (u, h) in enumerate(zip(value[1:].tolist(), np.diff(time).tolist(), strict=True)):
        current = min(max(u, current - h / slowness), current + h / slowness)
        result[k + 1] = current
    return result


def _clamped(lower: Array, upper: Array, first: float) -> Array:
    """(N,) x[k] = x[k-1] limited to lower[k] .. upper[k], with `first` before x[0]; all k at once, by doubling.

    Limiting to two intervals in turn equals limiting to one interval: the first with its ends limited to the second.
    """
    low, high = lower.copy(), upper.copy()
    reach = 1
    while reach < low.size:
        ends = [np.minimum(np.maximum(e[:-reach], low[reach:]), high[reach:]) for e in (low, high)]
        low[reach:], high[reach:] = ends
        reach *= 2
    return np.minimum(np.maximum(first, low), high)


def _bend(time: Array, value: Array, share: float) -> Array:
    """The samples unchanged. Half-way between two samples the input lies beyond their straight line by `share` times their
    difference (`engine.simulate` applies it). A servo that lags after an edge on the sampling clock has a share above zero."""
    return value


def _scale(time: Array, value: Array, factor: float) -> Array:
    return factor * value


def _bias(time: Array, value: Array, offset: float) -> Array:
    return value + offset


FUNCTIONS: Mapping[str, tuple[Callable[[Array, Array, float], Array], float]] = {
    "delay": (_delay, 1e-4),
    "lag": (_lag, 1e-4),
    "deadzone": (_deadzone, 1e-5),
    "backlash": (_backlash, 1e-5),
    "rate_limit": (_rate_limit, 1e-4),
    "bend": (_bend, 1e-4),
    "scale": (_scale, 1e-4),
    "bias": (_bias, 1e-5),
}
"""Kind -> (function, step of the central difference)."""
LINEAR = frozenset({"delay", "lag", "bend", "scale"})  # in their input


def apply_transforms(
    transforms: tuple[InputTransform, ...],
    input_names: tuple[str, ...],
    time: Array,
    u: Array,
    values: Mapping[str, float],
) -> Array:
    """The transformed inputs (N, nu).

    Several delays of one input are applied as one, their sum: two opposite ones applied in turn would blur edges.
    """
    u = u.copy()
    delays: dict[str, float] = {}
    for t in transforms:
        if t.kind == "delay":
            delays[t.input] = delays.get(t.input, 0.0) + values[t.parameters[0]]
    for t in transforms:
        column = input_names.index(t.input)
        if t.kind != "delay":
            u[:, column] = FUNCTIONS[t.kind][0](time, u[:, column], values[t.parameters[0]])
        elif t.input in delays:
            u[:, column] = _delay(time, u[:, column], delays.pop(t.input))
    return u


def transform_derivatives(
    transforms: tuple[InputTransform, ...],
    input_names: tuple[str, ...],
    time: Array,
    u: Array,
    values: Mapping[str, float],
    names: tuple[str, ...],
) -> Array:
    """(N, nu, len(names)) derivatives of the transformed inputs with respect to the named parameters."""
    steps = {t.parameters[0]: FUNCTIONS[t.kind][1] for t in transforms}
    result = np.zeros((*u.shape, len(names)))
    for j, name in enumerate(names):
        h = steps[name]
        acting, columns = acting_on({t.input for t in transforms if name in t.parameters}, transforms, input_names)
        inputs, u_acting = tuple(input_names[c] for c in columns), u[:, columns]
        plus = apply_transforms(acting, inputs, time, u_acting, {**values, name: values[name] + h})
        minus = apply_transforms(acting, inputs, time, u_acting, {**values, name: values[name] - h})
        result[:, columns, j] = (plus - minus) / (2 * h)
    return result


def acting_on(
    inputs: Collection[str], transforms: tuple[InputTransform, ...], input_names: tuple[str, ...]
) -> tuple[tuple[InputTransform, ...], list[int]]:
    """The transforms of some inputs, and the columns of these inputs (a transform acts on its own input only)."""
    return tuple(t for t in transforms if t.input in inputs), [i for i, n in enumerate(input_names) if n in inputs]
