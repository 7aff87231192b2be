"""Records linearised about a fit, with the residuals of the flights and of nulls beside the sensitivities.

Every test after a fit (hypotheses, nameless terms, shapes, events in time) adds columns and needs their products with these. They
are whitened once, and the unknowns of a record alone (initial states, biases) are projected out of all.
The column of a disturbance is the response of the outputs to a small one, which enters at a door: an input added to a force or
moment equation.
"""

from collections.abc import Callable, Iterable, Iterator, Sequence
from dataclasses import dataclass
from functools import cached_property
from itertools import islice

import numpy as np
from numpy.typing import NDArray

from estimation.engine.kernel import Array
from estimation.errors import GapError
from estimation.estimators.normal_equations import pseudo_inverse
from estimation.gap.fit.fitting import local_prior
from estimation.gap.fit.problem import LikelihoodProblem, ModelFit
from estimation.gap.fit.whitener import White
from estimation.gap.records.candidate_model import DISTURBANCE

AT_ONCE = 60  # disturbances in one run: the arrays of some hundred would fill a small machine
RUNAWAY = 1e9  # a response this large is no longer that to a small change
CACHE = 2**26  # bytes of whitened columns kept from one test to the next: for hours of flight they are computed again


def is_door(name: str) -> bool:
    """Whether an input is a disturbance of a force or moment equation."""
    return name.startswith(DISTURBANCE.format(""))


def output_changes(
    problem: LikelihoodProblem, model_fit: ModelFit, index: int, additions: Sequence[tuple[str, Array]]
) -> Iterator[Array]:
    """(N, ny) changes of the outputs of one record by each of `additions`: a course (N,) added to an output or entering at a
    door.

    Zero where a response runs away, and for a door where nothing was measured.
    """
    z, outputs, values = problem.coarse[index].z, problem.model.output_names, model_fit.values
    through_doors = responses(
        lambda du: problem.disturbed(index, values, model_fit.locals[index], du),
        problem.model.input_names,
        [(place, course) for place, course in additions if place not in outputs],
        ~np.isfinite(model_fit.residuals[index]),
    )
    for place, course in additions:
        if place in outputs:
            change = np.zeros_like(z)
            change[:, outputs.index(place)] = course
            yield change
        else:
            yield next(through_doors)


def responses(
    respond: Callable[[Array], Array | None],
    inputs: Sequence[str],
    additions: Sequence[tuple[str, Array]],
    unmeasured: NDArray[np.bool_],
) -> Iterator[Array]:
    """(N, ny) changes of the outputs by each of `additions`, an input and a course (M,), computed in batches that fit in memory.

    respond: small changes (M, inputs, k) of the inputs -> (N, ny, k) of the outputs, None where the motion runs away. Zero where
    a change runs away, or where `unmeasured` (N, ny).
    """
    for first in range(0, len(additions), AT_ONCE):
        batch = additions[first : first + AT_ONCE]
        du = np.zeros((len(batch[0][1]), len(inputs), len(batch)))
        for k, (name, course) in enumerate(batch):
            du[:, inputs.index(name), k] = course
        changes = respond(du)
        if changes is None:
            changes = np.zeros((*unmeasured.shape, len(batch)))
        changes[unmeasured] = 0.0
        finite = np.abs(changes).max(axis=(0, 1)) < RUNAWAY
        for k in range(len(batch)):
            yield changes[:, :, k] if finite[k] else np.zeros(unmeasured.shape)


@dataclass(frozen=True)
class TangentColumns:
    """k whitened columns of one record. local: (unknowns of the record alone, k) their products with these unknowns."""

    white: White
    local: Array

    def some(self, columns: Sequence[int]) -> "TangentColumns":
        """A selection of the columns."""
        return TangentColumns(self.white.some(np.asarray(columns, dtype=np.intp)), self.local[:, list(columns)])


@dataclass(frozen=True)
class RecordTangent:
    """One record. fixed: [shared unknowns | residual of the flight | residuals of the nulls]; local: the unknowns of the record
    alone; local_inverse: inverse of their information with the priors."""

    problem: LikelihoodProblem
    index: int
    fixed: TangentColumns
    local: White
    local_inverse: Array
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
        block = np.stack([residual, *nulls], axis=2)
        block[missing] = 0.0
        white = problem.whiteners[index].white(dy, block)
        indices, unknowns = np.arange(white.rows.shape[1]), dy.shape[2]
        local, fixed = white.some(indices[n:unknowns]), white.some(np.delete(indices, slice(n, unknowns)))
        weight, distance = local_prior(problem, fit.locals[index], unknowns - n)
        inverse = pseudo_inverse(local.products(local) + np.diag(weight))[0]
        local_products = local.products(fixed)
        local_products[:, n] += distance
        return cls(problem, index, TangentColumns(fixed, local_products), local, inverse, missing)

    @property
    def size(self) -> int:
        """Memory of the columns [bytes]."""
        return self.fixed.white.rows.nbytes + self.local.rows.nbytes

    def columns(self, changes: Iterable[Array]) -> TangentColumns:
        """Whitened changes of the outputs, (N, ny) each."""
        source, whitener = iter(changes), self.problem.whiteners[self.index]
        whites = [whitener.white(np.zeros((*self.missing.shape, 0)))]
        while batch := list(islice(source, AT_ONCE)):
            block = np.stack(batch, axis=2)
            block[self.missing] = 0.0
            whites.append(whitener.white(block))
        white = White.beside(whites)
        return TangentColumns(white, self.local.products(white))

    def products(self, a: TangentColumns, b: TangentColumns) -> Array:
        """(columns of a, columns of b) with the unknowns of the record alone projected out."""
        return np.asarray(a.white.products(b.white) - a.local.T @ self.local_inverse @ b.local)

    def squares(self, a: TangentColumns) -> Array:
        """(columns,) product of each with itself, as `products` has it."""
        return np.asarray(a.white.squares() - np.sum(a.local * (self.local_inverse @ a.local), axis=0))

    @cached_property
    def gram(self) -> Array:
        """Products of the fixed columns."""
        return self.products(self.fixed, self.fixed)

    def gram_with(self, changes: Iterable[Array]) -> Array:
        """Gram matrix of [shared unknowns | changes | residuals]."""
        n, extra = len(self.problem.free), self.columns(changes)
        if not extra.local.shape[1]:
            return self.gram
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
    def _cache(self) -> dict[int, RecordTangent]:
        return {}

    def record(self, index: int) -> RecordTangent:
        """One record. Raises GapError where the fitted motion cannot be linearised."""
        if index in self._cache:
            return self._cache[index]
        tangent = RecordTangent.of(self.problem, self.fit, index, [null[index] for null in self.nulls])
        if tangent.size + sum(record.size for record in self._cache.values()) <= CACHE:
            self._cache[index] = tangent
        return tangent

    def forget(self) -> None:
        """Give back the memory of all records: each is linearised again where it is needed."""
        self._cache.clear()

    def of(self, selected: NDArray[np.bool_]) -> "Tangent":
        """The same with some of the nulls. selected: (nulls,)."""
        return Tangent(self.problem, self.fit, tuple(n for n, use in zip(self.nulls, selected, strict=True) if use))
