"""Controls that answer gusts, as the model moves them: what they did without gusts, and feedback of the modelled motion.

A recorded control that answers gusts is correlated with the residual, and so bends every fit by output error. Its answer is taken
off it: the gains by which it follows the motion, times what the model leaves of the motion. What remains is what the control
would have done without gusts, to the accuracy of the gains. The model then moves the control by the same gains times the
modelled motion beside that, so that gusts, effects and derivatives act in the closed loop as they do in flight (the two-stage
method of P. M. J. Van den Hof and R. J. P. Schrama, Automatica 29 (1993) 1523-1527).
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np

from estimation.engine.kernel import Array
from estimation.gap.fit.baseline import Baseline
from estimation.gap.records.flight_records import FlightRecord
from estimation.gap.significance.closed_loop import feedback_of
from estimation.models.base import Model, Signal, renamed
from groundstation.flight import Flight

FOLLOWED = "followed_{}"
MOVED = "{}_moved"


@dataclass(frozen=True)
class Feedback:
    """How the controls of all flights follow the motion.

    gains: control -> (2, states) by the motion at a sample and at the sample before. still: per flight (N, states) motion of a
    fitted base without gusts; gusts: per flight (N, states) the measured motion beside it; both zero where nothing is fitted or
    measured.
    """

    base: Model
    gains: Mapping[str, Array]
    still: tuple[Array, ...]
    gusts: tuple[Array, ...]

    @classmethod
    def of(cls, baseline: Baseline, flights: Sequence[Flight]) -> "Feedback":
        """From a fit to flights, training ones first."""
        base, count = baseline.prepared.base, len(baseline.prepared.base.states)
        gains = {n: g.reshape(2, count) for n, g in feedback_of(baseline.problem.records, base).items()}
        still, gusts = ([np.zeros((len(f), count)) for f in flights] for _ in range(2))
        for problem, fit in filter(None, ((baseline.problem, baseline.fit), baseline.held_out)):
            columns = [problem.model.state_names.index(n) for n in base.state_names]
            outputs = {n: i for i, n in enumerate(problem.model.output_names)}
            measured = [(j, outputs[n]) for j, n in enumerate(base.state_names) if n in outputs]
            for i, (record, local) in enumerate(zip(problem.records, fit.locals, strict=True)):
                rows = slice(record.first, record.first + len(record))
                segment = problem.driven(problem.grids[i], fit.values)
                motion = problem.simulator.run_by_middles(segment, {**fit.values, **local.parameters}, local.x0)
                still[record.flight][rows] = motion.x[:, columns]
                for state, output in measured:
                    gusts[record.flight][rows, state] = np.nan_to_num(fit.residuals[i][:, output])
        return cls(base, gains, tuple(still), tuple(gusts))

    def without_answers(self, index: int, flight: Flight) -> Flight:
        """A flight with its controls as they would have been without gusts."""
        gusts = self.gusts[index]
        before = np.concatenate([gusts[:1], gusts[:-1]])
        sources = {s.name: s.source for s in self.base.inputs}
        answers = {n: gusts @ now + before @ then for n, (now, then) in self.gains.items()}
        return flight.with_columns(**{sources[n]: flight[sources[n]] - a for n, a in answers.items()})

    def followed(self, record: FlightRecord) -> FlightRecord:
        """A record with what each control follows in the fitted motion."""
        still = self.still[record.flight][record.first : record.first + len(record)]
        courses = {FOLLOWED.format(n): still @ g.sum(axis=0) for n, g in self.gains.items()}
        return replace(record, inputs={**record.inputs, **courses})

    def added_to(self, model: Model) -> Model:
        """A model whose controls follow its motion beside that of the fit."""
        moved = {n: MOVED.format(n) for n in self.gains}
        replaced = {}
        for symbol, expression in model.definitions.items():
            for name, new in moved.items():
                expression = renamed(expression, name, new)
            if expression != model.definitions[symbol]:
                replaced[symbol] = expression
        lines = []
        for name, gains in self.gains.items():
            parts = zip(gains.sum(axis=0), self.base.state_names, strict=True)
            law = " + ".join(f"({float(g)!r})*{s}" for g, s in parts)
            lines.append(f"{moved[name]} = {name} + {law} - {FOLLOWED.format(name)}")
        return model.plus(replaced=replaced, lines=lines, inputs=[Signal(FOLLOWED.format(n)) for n in self.gains])
