"""Records linearised about a fit, with the residuals of the flights and of nulls beside the sensitivities.

Everything that is asked of a fit afterwards, hypotheses, nameless terms, shapes, events in time, adds columns of its own and
needs their products with these. They are whitened once, and what is a record's own (initial states, biases) is taken out of all.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from estimation.engine.kernel import Array
from estimation.estimators.normal_equations import pseudo_inverse
from estimation.gap.errors import GapError
from estimation.gap.likelihood.fitting import LikelihoodProblem, ModelFit, local_prior
from estimation.gap.likelihood.whitening import White

KEPT = 2**26  # bytes of white columns kept from one question to the next: of hours of flight they are made anew


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
        found = problem.linearised(index, fit.values, fit.locals[index])
        if found is None:
            raise GapError(
                f"model {problem.base.name}: the motion runs away from the smallest change of a parameter; cut the flights into "
                "shorter segments"
            )
        residual, dy = found
        missing, n = ~np.isfinite(residual), len(problem.free)
        block = np.concatenate([dy, residual[:, :, None], *(null[:, :, None] for null in nulls)], axis=2)
        block[missing] = 0.0
        every = problem.whiteners[index].white(block)
        at = np.arange(dy.shape[2])
        of_own, fixed = every.some(at[n:]), every.some(np.concatenate([at[:n], np.arange(at.size, block.shape[2])]))
        weight, distance = local_prior(problem, fit.locals[index], at.size - n)
        left = pseudo_inverse(of_own.products(of_own) + np.diag(weight))[0]
        own = of_own.products(fixed)
        own[:, n] += distance
        return cls(problem, index, TangentColumns(fixed, own), left, of_own, missing)

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
        n, more = len(self.problem.free), self.columns(changes)
        across, own = self.products(more, self.fixed), self.products(more, more)
        return np.block(
            [
                [self.gram[:n, :n], across[:, :n].T, self.gram[:n, n:]],
                [across[:, :n], own, across[:, n:]],
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
        made = RecordTangent.of(self.problem, self.fit, index, [null[index] for null in self.nulls])
        if made.size + sum(record.size for record in self._kept.values()) <= KEPT:
            self._kept[index] = made
        return made

    def of(self, kept: NDArray[np.bool_]) -> "Tangent":
        """The same with some of the nulls. kept: (nulls,)."""
        return Tangent(self.problem, self.fit, tuple(null for null, k in zip(self.nulls, kept, strict=True) if k))
