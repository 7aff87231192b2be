"""Simulation of a model over a prepared segment, with exact sensitivities, on one of two back ends (compiled, virtual machine).

Input transforms and output delays are applied here; a back end only integrates the equations.
"""

from collections.abc import Mapping
from dataclasses import dataclass, replace
from functools import lru_cache
from typing import Literal

import numpy as np

from estimation.engine.compiled import compile_kernel
from estimation.engine.kernel import Array, Kernel, SegmentInputs, SegmentMotion, SensitivityColumns
from estimation.engine.transforms import LINEAR, acting_on, apply_transforms, transform_derivatives
from estimation.models.base import Model
from estimation.models.parts import ModelStructure
from estimation.prepare.flight_data import AS_USUAL, FlightData, Preparation, Segment
from estimation.prepare.pipeline import prepare
from estimation.signals.curves import half_way, inner_slopes
from groundstation.flight import Flight

Compile = Literal["auto", "never"]
"""auto: compiled wherever there is gcc, although a first run waits for it, so that a fit always gives the same bits."""
CHANGE_FRACTION = 1e-3  # of a change of the inputs: step of central differences of the input transforms
SLOPE_STEP = 1e-5  # of a derivative of the inputs: step of central differences of the monotone cubic
Hold = Literal["smooth", "linear", "hold"]
"""Inputs between samples: on a monotone cubic, on straight lines, or held. See `usual_hold`."""


def usual_hold(model: Model) -> Hold:
    """The inputs between samples: on a monotone cubic where servos drive the model, on straight lines otherwise.

    A servo's edge is a curve; straight lines through its samples make roll derivatives up to 2 % too large at 20 Hz.
    """
    return "smooth" if any(s.servo for s in model.inputs) else "linear"


@lru_cache(maxsize=128)
def _kernel(structure: ModelStructure, compile_: Compile) -> Kernel:
    compiled = None if compile_ == "never" else compile_kernel(structure)
    if compiled is not None:
        return compiled
    from estimation.engine.virtual import VirtualKernel

    return VirtualKernel(structure)


def kernel_for(model: Model, compile_: Compile = "auto") -> Kernel:
    """The back end for a model: compiled (0.6 s once on each computer, then cached), or the virtual machine without a
    compiler."""
    return _kernel(model.structure, compile_)


@dataclass(frozen=True)
class Simulator:
    """A model bound to a back end. free: names of the parameters that get a sensitivity column, in that order. substeps:
    integration steps between two samples."""

    model: Model
    free: tuple[str, ...]
    kernel: Kernel
    substeps: int = 2
    hold: Hold = "linear"

    @classmethod
    def build(
        cls,
        model: Model,
        free: tuple[str, ...] | None = None,
        *,
        compile_: Compile = "auto",
        substeps: int = 2,
        hold: Hold | None = None,
    ) -> "Simulator":
        """free: by default the free parameters of the model; hold: by default `usual_hold`."""
        names = model.free_names if free is None else free
        return cls(model, names, kernel_for(model, compile_), substeps, hold or usual_hold(model))

    def vector(self, values: Mapping[str, float]) -> Array:
        """(np,) parameters and constants in the order of the traced functions."""
        constants = self.model.structure.remaining_constants
        return np.array(
            [values[n] for n in self.model.parameter_names] + [self.model.constants[n] for n in constants], float
        )

    def columns(self, gain_free: Array | None = None, moved: int = 0) -> SensitivityColumns:
        """Sensitivity columns: free parameters, initial states, entries of the gain that `gain_free` (nx, ny) marks, then `moved`
        changes of the inputs."""
        nx, ny = len(self.model.states), len(self.model.outputs)
        names = (*self.model.parameter_names, *self.model.structure.remaining_constants)
        position = {name: i for i, name in enumerate(self.free)}
        parameter = np.array([position.get(n, -1) for n in names], np.int32)
        count = len(self.free) + nx
        state = np.arange(len(self.free), count, dtype=np.int32)
        transform = np.array([position[n] for n in self.transform_names()], np.int32)
        gain = np.full((nx, ny), -1, np.int32)
        if gain_free is not None:
            entries = np.argwhere(gain_free)
            gain[entries[:, 0], entries[:, 1]] = np.arange(count, count + len(entries))
            count += len(entries)
        transform = np.concatenate([transform, np.arange(count, count + moved, dtype=np.int32)])
        return SensitivityColumns(count + moved, parameter, state, transform, gain)

    def transform_names(self) -> tuple[str, ...]:
        """The free parameters of input transforms."""
        return tuple(dict.fromkeys(n for t in self.model.transforms for n in t.parameters if n in self.free))

    def drive(
        self, segment: Segment, values: Mapping[str, float], sensitivities: bool, moved: Array | None = None
    ) -> SegmentInputs:
        """Inputs of one segment for the integrator, transforms applied. moved: as of `run_by_middles`."""
        u, du = self._transformed(segment, values, sensitivities, moved)
        step = np.diff(segment.time)
        return SegmentInputs(
            np.append(step, 0.0),
            u,
            self._middle(u, step) + self._bends(u, step, values),
            self._end(u),
            segment.z,
            du,
            self._middle_slopes(u, du, step) + self._bend_slopes(u, du, step, values),
            self._end(du),
        )

    def _bent_inputs(self) -> list[tuple[int, str]]:
        """Column and parameter of each input with a transform `bend`, which shapes it between samples."""
        names = self.model.input_names
        return [(names.index(t.input), t.parameters[0]) for t in self.model.transforms if t.kind == "bend"]

    def _bends(self, u: Array, step: Array, values: Mapping[str, float]) -> Array:
        """(N, nu) change of the inputs half-way between samples by transforms `bend`, which put them on the straight line plus
        the parameter times the change between the samples."""
        bends = np.zeros_like(u)
        if not self._bent_inputs():
            return bends
        middle = self._middle(u, step)
        for column, name in self._bent_inputs():
            line = 0.5 * (u[:-1, column] + u[1:, column])
            bends[:-1, column] = line + values[name] * np.diff(u[:, column]) - middle[:-1, column]
        return bends

    def _bend_slopes(self, u: Array, du: Array, step: Array, values: Mapping[str, float]) -> Array:
        """(N, nu, nt) derivatives of `_bends`."""
        slopes = np.zeros_like(du)
        if not du.shape[2] or not self._bent_inputs():
            return slopes
        middle = self._middle_slopes(u, du, step)
        names = self.transform_names()
        for column, name in self._bent_inputs():
            line = 0.5 * (du[:-1, column] + du[1:, column])
            slopes[:-1, column] = line + values[name] * np.diff(du[:, column], axis=0) - middle[:-1, column]
            if name in names:
                slopes[:-1, column, names.index(name)] += np.diff(u[:, column])
        return slopes

    def _transformed(
        self, segment: Segment, values: Mapping[str, float], sensitivities: bool, moved: Array | None = None
    ) -> tuple[Array, Array]:
        """Transformed inputs (N, nu) and their derivatives (N, nu, nt): by the transforms' parameters if `sensitivities`, then
        along the changes `moved`."""
        model, u = self.model, segment.u
        names = self.transform_names() if sensitivities else ()
        du = np.zeros((*u.shape, 0))
        changes = moved
        if model.transforms:
            if names:
                du = transform_derivatives(model.transforms, model.input_names, segment.time, u, values, names)
            if moved is not None:
                changes = self._transformed_changes(segment, values, moved)
            u = apply_transforms(model.transforms, model.input_names, segment.time, u, values)
        return u, du if changes is None else np.concatenate([du, changes], axis=2)

    def _transformed_changes(self, segment: Segment, values: Mapping[str, float], moved: Array) -> Array:
        """(N, nu, k) changes of the transformed inputs for small changes `moved` (N, nu, k) of the inputs."""
        model, changes = self.model, moved.copy()
        transformed = {t.input for t in model.transforms}
        for k in range(moved.shape[2]):
            affected = {n for i, n in enumerate(model.input_names) if n in transformed and moved[:, i, k].any()}
            if not affected:
                continue
            transforms, columns = acting_on(affected, model.transforms, model.input_names)
            inputs, u = tuple(model.input_names[c] for c in columns), segment.u[:, columns]
            if all(t.kind in LINEAR for t in transforms):
                changes[:, columns, k] = apply_transforms(
                    transforms, inputs, segment.time, moved[:, columns, k], values
                )
                continue
            plus, minus = (
                apply_transforms(transforms, inputs, segment.time, u + share * moved[:, columns, k], values)
                for share in (CHANGE_FRACTION, -CHANGE_FRACTION)
            )
            changes[:, columns, k] = (plus - minus) / (2.0 * CHANGE_FRACTION)
        return changes

    def _end(self, values: Array) -> Array:
        """Inputs (or their derivatives) at the end of the interval after each sample."""
        return values if self.hold == "hold" else np.ascontiguousarray(np.concatenate([values[1:], values[-1:]]))

    def _middle(self, values: Array, step: Array) -> Array:
        """Inputs half-way to the next sample."""
        if self.hold == "hold":
            return values
        middle = values.copy()
        if self.hold == "smooth" and len(values) > 2:
            middle[:-1] = _midpoints(values, step)
        else:
            middle[:-1] = 0.5 * (values[:-1] + values[1:])
        return middle

    def _middle_slopes(self, u: Array, du: Array, step: Array) -> Array:
        """Derivatives (N, nu, nt) of `_middle`, by central differences of the monotone cubic, which is not linear."""
        if not du.shape[2]:
            return du
        if self.hold != "smooth":
            return self._middle(du, step)
        h = SLOPE_STEP
        ends = [(u + h * du[:, :, t], u - h * du[:, :, t]) for t in range(du.shape[2])]
        return np.stack(
            [(self._middle(plus, step) - self._middle(minus, step)) / (2 * h) for plus, minus in ends], axis=2
        )

    def run(
        self,
        segment: Segment,
        values: Mapping[str, float],
        x0: Array,
        *,
        sensitivities: bool = False,
        gain: Array | None = None,
        gain_free: Array | None = None,
        moved: Array | None = None,
    ) -> SegmentMotion:
        """Motion of one segment from x0 (nx,); with `sensitivities` also dy, with the columns of `columns`.

        gain: (nx, ny) of the innovations form; gain_free: (nx, ny) its entries that get a column; moved: as of `run_by_middles`.
        """
        drive = self.drive(segment, values, sensitivities, moved)
        columns = self.columns(gain_free, 0 if moved is None else moved.shape[2]) if sensitivities else None
        x0 = np.ascontiguousarray(x0, float)
        motion = self.kernel.run(drive, self.vector(values), x0, self.substeps, columns, gain)
        if self.model.output_delays and motion.finite:
            motion = self._delayed(motion, segment.time, values)
        return motion

    def run_by_middles(
        self,
        segment: Segment,
        values: Mapping[str, float],
        x0: Array,
        *,
        sensitivities: bool = False,
        moved: Array | None = None,
    ) -> SegmentMotion:
        """Motion x, y, dy at the even samples of a segment whose odd samples lie half-way between them. Steps and inputs are
        those of `run` with inputs on straight lines.

        moved: (samples, nu, k) changes of the inputs; the last k columns of dy are derivatives along them.
        """
        if self.model.output_delays:  # their interpolation needs all samples
            motion = self.run(segment, values, x0, sensitivities=sensitivities, moved=moved)
            dy = None if motion.dy is None else motion.dy[::2]
            return SegmentMotion(motion.x[::2], motion.y[::2], dy, (motion.reached + 1) // 2)
        u, du = self._transformed(segment, values, sensitivities, moved)
        drive = SegmentInputs(
            np.append(segment.time[2::2] - segment.time[:-2:2], 0.0), *_by_middles(u), segment.z[::2], *_by_middles(du)
        )
        columns = self.columns(moved=0 if moved is None else moved.shape[2]) if sensitivities else None
        return self.kernel.run(drive, self.vector(values), np.ascontiguousarray(x0, float), 2 * self.substeps, columns)

    def response(
        self,
        segment: Segment,
        values: Mapping[str, float],
        x0: Array,
        du: Array,
        du_mid: Array,
        *,
        gain: Array | None = None,
    ) -> Array:
        """(N, ny, k) change of the outputs with k small changes of the inputs, linearised about the motion from x0.

        du: (N, nu, k) at the samples; du_mid: (N, nu, k) half-way to the next one (last entry unused).
        """
        k, nx, ny = du.shape[2], len(self.model.states), len(self.model.outputs)
        p = self.vector(values)
        no_parameter, no_state = np.full(p.size, -1, np.int32), np.full(nx, -1, np.int32)
        columns = SensitivityColumns(
            k, no_parameter, no_state, np.arange(k, dtype=np.int32), np.full((nx, ny), -1, np.int32)
        )
        du, du_mid = np.ascontiguousarray(du), np.ascontiguousarray(du_mid)
        drive = replace(self.drive(segment, values, False), du=du, du_mid=du_mid, du_end=self._end(du))
        motion = self.kernel.run(drive, p, np.ascontiguousarray(x0, float), self.substeps, columns, gain)
        if motion.dy is None or not motion.finite:
            return np.zeros((len(segment), ny, k))
        dy = motion.dy.copy()
        for output, name in self.model.output_delays.items():
            c = self.model.output_names.index(output)
            weights, rows, _ = _cubic(segment.time, segment.time - values[name])
            dy[:, c] = np.einsum("ij,ijn->in", weights, motion.dy[rows, c])
        return dy

    def _delayed(self, motion: SegmentMotion, time: Array, values: Mapping[str, float]) -> SegmentMotion:
        """The motion with its outputs delayed: cubic interpolation between samples, the first value before the record."""
        y = motion.y.copy()
        dy = None if motion.dy is None else motion.dy.copy()
        for output, name in self.model.output_delays.items():
            c = self.model.output_names.index(output)
            weights, rows, slope = _cubic(time, time - values[name])
            y[:, c] = np.einsum("ij,ij->i", weights, motion.y[rows, c])
            if dy is not None and motion.dy is not None:
                dy[:, c] = np.einsum("ij,ijn->in", weights, motion.dy[rows, c])
                if name in self.free:
                    dy[:, c, self.free.index(name)] -= np.einsum("ij,ij->i", slope, motion.y[rows, c])
        return SegmentMotion(motion.x, y, dy, motion.reached)


def _by_middles(values: Array) -> tuple[Array, Array, Array]:
    """(N, ...) values at the samples, half-way to the next sample and at the next sample, from values (2N - 1, ...) at samples
    and middles."""
    middle, end = (np.concatenate([values[first::2], values[-1:]]) for first in (1, 2))
    return np.ascontiguousarray(values[::2]), middle, end


def _midpoints(u: Array, step: Array) -> Array:
    """(N - 1, nu) values half-way between samples on a monotone cubic that ends with its chords; flat between equal samples."""
    length = step[:, None]
    chord = np.diff(u, axis=0) / length
    slope = np.zeros_like(u)
    slope[0], slope[-1] = chord[0], chord[-1]
    slope[1:-1] = inner_slopes(chord, length)
    return half_way(u, slope, length)


def _cubic(time: Array, times: Array) -> tuple[Array, np.ndarray, Array]:  # type: ignore[type-arg]
    """Cubic interpolation at `times` (N,): Lagrange weights (N, 4), sample indices (N, 4) and weights of the derivative (N,
    4)."""
    outside = (times < time[0]) | (times > time[-1])
    inside = np.clip(times, time[0], time[-1])
    first = np.clip(np.searchsorted(time, inside, side="right") - 2, 0, time.size - 4)
    rows = first[:, None] + np.arange(4)
    knots = time[rows]
    weights, slope = np.ones(rows.shape), np.zeros(rows.shape)
    for j in range(4):
        others = [m for m in range(4) if m != j]
        gaps = [knots[:, j] - knots[:, m] for m in others]
        terms = [(inside - knots[:, m]) / gap for m, gap in zip(others, gaps, strict=True)]
        weights[:, j] = terms[0] * terms[1] * terms[2]
        slope[:, j] = terms[1] * terms[2] / gaps[0] + terms[0] * terms[2] / gaps[1] + terms[0] * terms[1] / gaps[2]
    slope[outside] = 0.0
    return weights, rows, slope


# ----------------------------------------------------------------------------------------------- whole flights


def simulate(
    model: Model,
    flight: Flight | FlightData,
    values: Mapping[str, float] | None = None,
    x0: Array | None = None,
    *,
    compile_: Compile = "auto",
    substeps: int = 2,
    preparation: Preparation = AS_USUAL,
) -> Array:
    """Outputs (samples, ny) of a model over a flight with its measured inputs; NaN outside the segments.

    values: parameters (default: the model's start values); x0: initial state of every segment (default: as measured).
    """
    data = flight if isinstance(flight, FlightData) else prepare(model, flight, preparation)
    simulator = Simulator.build(model, (), compile_=compile_, substeps=substeps)
    y = np.full((data.samples, len(model.outputs)), np.nan)
    for segment in data.segments:
        motion = simulator.run(segment, {**model.starts(), **(values or {})}, segment.x0 if x0 is None else x0)
        y[segment.first : segment.first + motion.reached] = motion.y[: motion.reached]
    return y


def simulate_with_sensitivities(
    model: Model,
    flight: Flight | FlightData,
    values: Mapping[str, float] | None = None,
    x0: Array | None = None,
    *,
    free: tuple[str, ...] | None = None,
    compile_: Compile = "auto",
    substeps: int = 2,
    preparation: Preparation = AS_USUAL,
) -> tuple[Array, Array, Array]:
    """y (samples, ny), dy/dparameters (samples, ny, n), and dy/dx0 (samples, ny, nx) by the initial state of each sample's
    segment.

    free: the parameters of the columns, in that order (default: the free ones of the model).
    """
    data = flight if isinstance(flight, FlightData) else prepare(model, flight, preparation)
    simulator = Simulator.build(model, free, compile_=compile_, substeps=substeps)
    n, nx = len(simulator.free), len(model.states)
    y = np.full((data.samples, len(model.outputs)), np.nan)
    dy = np.full((data.samples, len(model.outputs), n + nx), np.nan)
    all_values = {**model.starts(), **(values or {})}
    for segment in data.segments:
        motion = simulator.run(segment, all_values, segment.x0 if x0 is None else x0, sensitivities=True)
        s = slice(segment.first, segment.first + motion.reached)
        y[s] = motion.y[: motion.reached]
        assert motion.dy is not None
        dy[s] = motion.dy[: motion.reached]
    return y, dy[:, :, :n], dy[:, :, n:]
