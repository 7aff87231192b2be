"""Records linearised about a fit, with the residuals of the flights and of nulls beside the sensitivities.

Everything that is asked of a fit afterwards, hypotheses, nameless terms, shapes, events in time, adds columns of its own and
needs their products with these. They are whitened once, and what is a record's own (initial states, biases) is taken out of all.
Columns of disturbances are what a small one does to the outputs, let in through a door: an input of a force or moment equation.
"""

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from estimation.engine.kernel import Array
from estimation.estimators.normal_equations import pseudo_inverse
from estimation.gap.errors import GapError
from estimation.gap.fit.fitting import local_prior
from estimation.gap.fit.problem import LikelihoodProblem, ModelFit
from estimation.gap.fit.whitener import White
from estimation.gap.records.candidate_model import DISTURBANCE

AT_ONCE = 60  # disturbances in one run: the arrays of some hundred would fill a small machine
RUNAWAY = 1e9  # a change that grows so far is no small one any more
KEPT = 2**26  # bytes of white columns kept from one question to the next: of hours of flight they are made anew


def is_door(name: str) -> bool:
    """Whether an input is one through which a force equation can be disturbed."""
    return name.startswith(DISTURBANCE.format(""))


def through_doors(
    problem: LikelihoodProblem, found: ModelFit, index: int, asks: Sequence[tuple[str, Array]]
) -> Iterator[Array]:
    """(N, ny) changes of the outputs of one record, by unit of each of `asks`: a door and the course (N,) through it.

    Nothing where they run away or nothing was measured.
    """
    return responses(
        lambda du: problem.disturbed(index, found.values, found.locals[index], du),
        problem.model.input_names,
        asks,
        ~np.isfinite(found.residuals[index]),
    )


def responses(
    respond: Callable[[Array], Array | None],
    inputs: Sequence[str],
    asks: Sequence[tuple[str, Array]],
    unmeasured: NDArray[np.bool_],
) -> Iterator[Array]:
    """(N, ny) changes of the outputs by each of `asks`: an input and its course (M,), so many at once as a small machine holds.

    respond: small changes (M, inputs, k) of the inputs -> (N, ny, k) of the outputs, None where the motion runs away. Nothing
    where a change runs away, or where `unmeasured` (N, ny).
    """
    for first in range(0, len(asks), AT_ONCE):
        batch = asks[first : first + AT_ONCE]
        du = np.zeros((len(batch[0][1]), len(inputs), len(batch)))
        for k, (name, course) in enumerate(batch):
            du[:, inputs.index(name), k] = course
        changes = respond(du)
        if changes is None:
            changes = np.zeros((*unmeasured.shape, len(batch)))
        changes[unmeasured] = 0.0
        for k in range(len(batch)):
            alive = np.abs(changes[:, :, k]).max() < RUNAWAY
            yield changes[:, :, k] if alive else np.zeros(unmeasured.shape)


@dataclass(frozen=True)
class TangentColumns:
    """Columns of one record. white: as they are weighed; own: (unknowns of its own, k) their products with these."""

    white: White
    own: Array

    def some(self, columns: Sequence[int]) -> "TangentColumns":
        """Some of them."""
        return TangentColumns(self.white.some(np.asarray(columns, dtype=np.intp)), self.own[:, list(columns)])


@dataclass(frozen=True)
class RecordTangent:
    """One record. fixed: [shared unknowns | residual of the flight | of every null]; of_own: unknowns of its own; left:
    inverse of their information with its priors."""

    problem: LikelihoodProblem
    index: int
    fixed: TangentColumns
    left: Array
    of_own: White
    missing: NDArray[np.bool_]

    @classmethod
    def of(cls, problem: LikelihoodProblem, fit: ModelFit, index: int, nulls: Sequence[Array]) -> "RecordTangent":
        """nulls: residuals (N, ny) of this record. Raises GapError where the fitted motion cannot be linearised."""
        linear = problem.linearised(index, fit.values, fit.locals[index])
        if linear is None:
            raise GapError(
                f"model {problem.base.name}: the motion runs away from the smallest change of a parameter; cut the flights into "
                "shorter segments"
            )
        residual, dy = linear
        missing, n = ~np.isfinite(residual), len(problem.free)
        block = np.concatenate([dy, residual[:, :, None], *(null[:, :, None] for null in nulls)], axis=2)
        block[missing] = 0.0
        white = problem.whiteners[index].white(block)
        indices = np.arange(dy.shape[2])
        of_own, fixed = (
            white.some(indices[n:]),
            white.some(np.concatenate([indices[:n], np.arange(indices.size, block.shape[2])])),
        )
        weight, distance = local_prior(problem, fit.locals[index], indices.size - n)
        inverse = pseudo_inverse(of_own.products(of_own) + np.diag(weight))[0]
        local_products = of_own.products(fixed)
        local_products[:, n] += distance
        return cls(problem, index, TangentColumns(fixed, local_products), inverse, of_own, missing)

    @property
    def size(self) -> int:
        """Bytes that its columns take."""
        return self.fixed.white.rows.nbytes + self.of_own.rows.nbytes

    def columns(self, changes: Sequence[Array]) -> TangentColumns:
        """Changes of the outputs, (N, ny) each."""
        block = np.stack(changes, axis=2) if len(changes) else np.zeros((*self.missing.shape, 0))
        block[self.missing] = 0.0
        white = self.problem.whiteners[self.index].white(block)
        return TangentColumns(white, self.of_own.products(white))

    def products(self, a: TangentColumns, b: TangentColumns) -> Array:
        """(columns of a, columns of b), what is the record's own taken out."""
        return np.asarray(a.white.products(b.white) - a.own.T @ self.left @ b.own)

    def squares(self, a: TangentColumns) -> Array:
        """(columns,) the products of all with themselves."""
        return np.asarray(a.white.squares() - np.sum(a.own * (self.left @ a.own), axis=0))

    @cached_property
    def gram(self) -> Array:
        """Products of the fixed columns."""
        return self.products(self.fixed, self.fixed)

    def gram_with(self, changes: Sequence[Array]) -> Array:
        """Gram matrix of [shared unknowns | changes | residuals]."""
        if not len(changes):
            return self.gram
        n, extra = len(self.problem.free), self.columns(changes)
        across, among = self.products(extra, self.fixed), self.products(extra, extra)
        return np.block(
            [
                [self.gram[:n, :n], across[:, :n].T, self.gram[:n, n:]],
                [across[:, :n], among, across[:, n:]],
                [self.gram[n:, :n], across[:, n:].T, self.gram[n:, n:]],
            ]
        )


@dataclass(frozen=True)
class Tangent:
    """All records of a fit. nulls: each a tuple of residuals (N, ny) per record."""

    problem: LikelihoodProblem
    fit: ModelFit
    nulls: tuple[tuple[Array, ...], ...] = ()

    @cached_property
    def _kept(self) -> dict[int, RecordTangent]:
        return {}

    def record(self, index: int) -> RecordTangent:
        """One record. Raises GapError where the fitted motion cannot be linearised."""
        if index in self._kept:
            return self._kept[index]
        tangent = RecordTangent.of(self.problem, self.fit, index, [null[index] for null in self.nulls])
        if tangent.size + sum(record.size for record in self._kept.values()) <= KEPT:
            self._kept[index] = tangent
        return tangent

    def of(self, kept: NDArray[np.bool_]) -> "Tangent":
        """The same with some of the nulls. kept: (nulls,)."""
        return Tangent(self.problem, self.fit, tuple(null for null, k in zip(self.nulls, kept, strict=True) if k))
