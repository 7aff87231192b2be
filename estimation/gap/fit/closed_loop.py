"""Controls that answer gusts, the loop that they close, and controls that do nothing else.

A pilot or an autopilot who holds an attitude moves the controls as gusts move the aircraft. Output error takes a recorded control
as given, independent of gusts. With feedback it is not: the response to it and the residual are correlated, which bends the
base, and every hypothesis that changes the response gains (L. Ljung, "System Identification: Theory for the User", 2nd ed.,
Prentice Hall 1999, section 13.4).

So what a control answers to gusts is taken off its record: the gains by which it follows the motion, times the motion that a
first fit leaves unexplained. What remains is what the control would have done in still air. The model then moves the control by
the same gains times its own motion beside that of the first fit, so that derivatives, effects, noise and nulls act in the closed
loop, as they did in flight. This is the two-stage method of P. M. J. Van den Hof and R. J. P. Schrama, Automatica 29 (1993)
1523-1527. The first fit may be bent: its motion is subtracted in the control and added in the model. What is left of it, because
a servo is late and the law of the model is not, goes with further passes.

A control that only holds an attitude cannot show when it moves, or whether it has play: delayed by a quarter of a second it
explains some of the gusts, the same in every flight, and no simulated null shows this, for nobody steers a null. Only steps and
slow moves that are not an answer to the motion show that. Without them delays and play of the control are no hypotheses.
"""

from collections.abc import Collection, Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np

from estimation.engine.kernel import Array
from estimation.gap.criteria import Criteria
from estimation.gap.effects.base import Effect
from estimation.gap.fit.baseline import Baseline
from estimation.gap.fit.problem import LikelihoodProblem, ModelFit
from estimation.gap.records.flight_records import FlightRecord
from estimation.models.base import Model, Parameter, ParameterRole, Signal, renamed
from estimation.signals.controls import ControlStretch, Gains, feedback_gains
from groundstation.flight import Flight

TENTH = 0.1  # of the largest part of a law, and of all answers: less does not matter
NEAR = 0.5  # of the noise of a control: a smaller change of its answers changes no derivative by a third of its bound
PASSES = 3  # of gains and of the steps beside what they make the control do
GAUSSIAN = 1.05  # times the median change between two samples is the noise: 1 / (0.6745 sqrt 2)
LATE = (0.0, 0.05, 0.1, 0.15, 0.2)  # s: delays of a hand, or of an autopilot with its servo
ENOUGH = 4  # samples per regressor: a shorter record shows nothing
FOLLOWED = "followed_{}"  # input: the part of a control that follows the motion of the first fit
IN_LOOP = "{}_in_loop"  # the control as the model moves it


def feedback_of(records: Sequence[FlightRecord], base: Model) -> dict[str, Array]:
    """Control -> (2, states) gains from the states of `base` at a sample and at the sample before. Without controls that do not
    follow the motion by more than chance."""
    pieces = [(r, r.states) for r in records if r.states is not None]
    if not pieces:
        return {}
    count = len(base.states)
    known = [j for j in range(count) if all(np.isfinite(states[:, j]).all() for _, states in pieces)]
    feedback = {}
    for name in (s.name for s in base.inputs if s.control):
        noise = float(np.median([r.input_noise.get(name, 0.0) for r in records]))
        stretches = [ControlStretch(r.inputs[name], r.inputs[name], states[:, known]) for r, states in pieces]
        fitted = _gains(stretches, noise) if known else None
        if fitted is not None:
            gains = np.zeros((2, count))
            gains[:, known] = fitted.gains.reshape(2, len(known))
            feedback[name] = gains
    return feedback


def _gains(stretches: Sequence[ControlStretch], noise: float) -> Gains | None:
    """Gains by which a control follows the motion.

    A change is a step where it is large beside the noise of the control and beside what the control usually does else than
    follow: answers to gusts, by the gains of an earlier pass, are no steps.
    """
    fitted = None
    for _ in range(PASSES):
        alone = [s if fitted is None else replace(s, smooth=s.values - s.following(fitted)) for s in stretches]
        usual = float(np.median(np.abs(np.concatenate([np.diff(s.smooth) for s in alone]))))
        fitted = feedback_gains(alone, max(noise, GAUSSIAN * usual))
    return fitted


@dataclass(frozen=True)
class ClosedLoop:
    """How the controls of some flights follow the motion, and what of the motion a fit explains.

    gains: control -> (2, states of `base`), as of `feedback_of`. still: per flight (N, states) the fitted motion; gusts: per
    flight (N, states) what the measured motion has beside it; both zero where nothing is fitted or measured.
    """

    base: Model
    gains: Mapping[str, Array]
    still: tuple[Array, ...]
    gusts: tuple[Array, ...]

    @classmethod
    def of(cls, baseline: Baseline, flights: Sequence[Flight], gains: Mapping[str, Array]) -> "ClosedLoop":
        """About a fit to `flights`, training ones first."""
        base = baseline.prepared.base
        still, gusts = ([np.zeros((len(f), len(base.states))) for f in flights] for _ in range(2))
        for problem, model_fit in filter(None, ((baseline.problem, baseline.fit), baseline.held_out)):
            for i, record in enumerate(problem.records):
                explained, unexplained = _motion(problem, model_fit, base, i)
                still[record.flight][record.rows], gusts[record.flight][record.rows] = explained, unexplained
        return cls(base, gains, tuple(still), tuple(gusts))

    def answers(self, flight: int, gains: Array) -> Array:
        """(N,) what a control of these gains answers to the gusts of one flight."""
        return _followed(self.gusts[flight], gains)

    def felt(self, baseline: Baseline, taken_off: "ClosedLoop | None" = None) -> tuple[str, ...]:
        """Controls that answer what the fit does not explain, by more than their own noise. taken_off: the loop whose answers the
        records of the fit lack.

        Between steps such a control goes with its answers as with the rest of the motion, on every flight; one whose gains come
        from manoeuvres does not. A missing effect counts as gusts: about a model that has it, the same has to be felt again.
        """
        records, least = baseline.problem.records, baseline.criteria.halfway
        flights = [[r for r in records if r.flight == k] for k in sorted({r.flight for r in records})]
        found = []
        for name, gains in self.gains.items():
            by_flight = [self._answered_share(f, name, gains, taken_off) for f in flights]
            share = self._answered_share(records, name, gains, taken_off)
            answers = np.mean([np.var(self.answers(r.flight, gains)) for r in records])
            is_one_law = all(least < s < 1.0 / least for s in by_flight)
            if is_one_law and share**2 * answers > _variance(records, name):
                found.append(name)
        return tuple(found)

    def _answered_share(
        self, records: Sequence[FlightRecord], name: str, gains: Array, taken_off: "ClosedLoop | None"
    ) -> float:
        """By how much of its answers to gusts a control moves between its steps; 0 where it does not go with the motion."""
        stretches = []
        for record in records:
            parts = [_followed(motion[record.flight], gains)[record.rows] for motion in (self.still, self.gusts)]
            values = record.inputs[name]
            if taken_off is not None and name in taken_off.gains:
                values = values + taken_off.answers(record.flight, taken_off.gains[name])[record.rows]
            stretches.append(ControlStretch(values, values - sum(parts), np.column_stack(parts)))
        fitted = _gains(stretches, float(np.sqrt(_variance(records, name))))
        return 0.0 if fitted is None else float(fitted.gains.reshape(2, 2)[:, 1].sum())

    def is_near(self, other: "ClosedLoop", records: Sequence[FlightRecord]) -> bool:
        """Whether the answers of all controls to gusts are those of another fit, to half their noise or a tenth of themselves."""
        for name, gains in self.gains.items():
            answers = [self.answers(r.flight, gains) for r in records]
            changes = [a - other.answers(r.flight, gains) for a, r in zip(answers, records, strict=True)]
            near = max(NEAR**2 * _variance(records, name), TENTH**2 * float(np.mean([np.var(a) for a in answers])))
            if np.mean([np.var(c) for c in changes]) > near:
                return False
        return True

    def without_answers(self, index: int, flight: Flight) -> Flight:
        """A flight with its controls as they would have been in still air."""
        sources = {s.name: s.source for s in self.base.inputs}
        courses = {sources[n]: flight[sources[n]] - self.answers(index, g) for n, g in self.gains.items()}
        return flight.with_columns(**courses)

    def in_words(self) -> tuple[str, ...]:
        """A note on each control, with the part of its law that matters."""
        size = np.std(np.concatenate(self.gusts), axis=0)
        notes = []
        for name, gains in self.gains.items():
            law = gains.sum(axis=0)
            parts = np.abs(law) * size
            shown = [
                f"{g:.2g} {s}"
                for g, s, p in zip(law, self.base.state_names, parts, strict=True)
                if p > TENTH * parts.max()
            ]
            notes.append(f"{name} answers gusts (by {' + '.join(shown)}): its answers are modelled, not taken as given")
        return tuple(notes)

    def with_followed(self, record: FlightRecord) -> FlightRecord:
        """A record with the part of each control that follows the fitted motion, as an input of the model."""
        still = self.still[record.flight][record.rows]
        followed = {FOLLOWED.format(n): still @ g.sum(axis=0) for n, g in self.gains.items()}
        return replace(record, inputs={**record.inputs, **followed})

    def closed(self, model: Model) -> Model:
        """A model whose controls follow its motion, beside the fitted motion, at once."""
        replaced = {symbol: self._in_loop(expression) for symbol, expression in model.definitions.items()}
        lines, parameters = [], []
        for name, gains in self.gains.items():
            # held parameters, not numbers in the equations, which would have to be compiled for every set of flights
            law = {f"gain_{name}_{state}": g for state, g in zip(self.base.state_names, gains.sum(axis=0), strict=True)}
            parameters += [
                Parameter(n, start=float(g), fixed=True, role=ParameterRole.NUISANCE) for n, g in law.items()
            ]
            feedback = " + ".join(f"{n}*{state}" for n, state in zip(law, self.base.state_names, strict=True))
            lines.append(f"{IN_LOOP.format(name)} = {name} + {feedback} - {FOLLOWED.format(name)}")
        inputs = [Signal(FOLLOWED.format(n)) for n in self.gains]
        return model.plus(replaced=replaced, lines=lines, parameters=parameters, inputs=inputs)

    def _in_loop(self, expression: str) -> str:
        for name in self.gains:
            expression = renamed(expression, name, IN_LOOP.format(name))
        return expression


def _followed(motion: Array, gains: Array) -> Array:
    """(N,) a control of these gains (2, states) that follows a motion (N, states)."""
    before = np.concatenate([motion[:1], motion[:-1]])
    return np.asarray(motion @ gains[0] + before @ gains[1])


def _variance(records: Sequence[FlightRecord], control: str) -> float:
    """Mean variance of the noise of a control."""
    return float(np.mean([r.input_noise.get(control, 0.0) ** 2 for r in records]))


def _motion(problem: LikelihoodProblem, model_fit: ModelFit, base: Model, index: int) -> tuple[Array, Array]:
    """(N, states of the base) of one record: the fitted motion, and the measured one beside it; both zero where it runs away."""
    local, size = model_fit.locals[index], (len(problem.records[index]), len(base.states))
    still, gusts = np.zeros(size), np.zeros(size)
    driven = problem.driven(problem.grids[index], model_fit.values)
    motion = problem.simulator.run_by_middles(driven, {**model_fit.values, **local.parameters}, local.x0)
    if not motion.finite:
        return still, gusts
    states, outputs = problem.model.state_names, problem.model.output_names
    for column, name in enumerate(base.state_names):
        still[:, column] = motion.x[:, states.index(name)]
        if name in outputs:
            gusts[:, column] = np.nan_to_num(model_fit.residuals[index][:, outputs.index(name)])
    return still, gusts


# ------------------------------------------------------------------------------------------------ controls that only follow


def only_following(records: Sequence[FlightRecord], model: Model, criteria: Criteria) -> tuple[str, ...]:
    """Controls of `model` that follow the measured motion on every record, by less than half of their noise."""
    controls = [s.name for s in model.inputs if s.control]
    return tuple(n for n in controls if all(_follows(r, n, criteria) for r in records))


def words_on(control: str) -> str:
    """The note on such a control."""
    return (
        f"{control} rests or only follows the motion: its delay and play are not searched; move it by itself, in steps"
    )


def _follows(record: FlightRecord, control: str, criteria: Criteria) -> bool:
    """Whether a control follows the measured motion on one record."""
    noise, motion = record.input_noise.get(control, 0.0), motion_regressors(record)
    if noise <= 0.0 or len(record) < ENOUGH * motion.shape[1]:
        return False
    return own_motion(record.inputs[control], motion) < criteria.halfway * noise


def own_motion(values: Array, motion: Array) -> float:
    """Rms of the part of a control (N,) that regressors (N, k) do not explain."""
    scale = np.abs(motion).max(axis=0)
    columns = motion[:, scale > 0.0] / scale[scale > 0.0]
    residual = values - columns @ np.linalg.lstsq(columns, values, rcond=None)[0]
    return float(np.sqrt(residual @ residual / (len(values) - columns.shape[1])))


def motion_regressors(record: FlightRecord) -> Array:
    """(N, k) what a control may follow: a straight line, the measured states now and shortly before, their integrals."""
    count = len(record)
    line = np.vander(np.linspace(-1.0, 1.0, count), 2)
    if record.states is None:
        return line
    states = record.states[:, np.isfinite(record.states).all(axis=0)]
    delays = sorted({round(t / record.interval) for t in LATE})
    delayed = [np.concatenate([states[:1].repeat(k, 0), states[: count - k]]) for k in delays]
    return np.column_stack([line, *delayed, np.cumsum(states - states.mean(axis=0), axis=0)])


def without_hardware_of(
    effects: Sequence[Effect], controls: Collection[str]
) -> tuple[tuple[Effect, ...], tuple[Effect, ...]]:
    """(effects without the forms that delay or bend only these controls, effects that have no form left)."""
    applicable, removed = [], []
    for effect in effects:
        forms = tuple(f for f in effect.forms if not f.transforms or any(t.input not in controls for t in f.transforms))
        if len(forms) == len(effect.forms):
            applicable.append(effect)
        elif forms:
            applicable.append(replace(effect, forms=forms))
        else:
            removed.append(effect)
    return tuple(applicable), tuple(removed)
