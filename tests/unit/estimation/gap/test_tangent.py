"""Records linearised about a fit, against least squares on all white rows; and what the optimiser is told at its first point."""

import numpy as np
import pytest

from estimation.engine.kernel import Array
from estimation.gap.fit.fitting import ProblemUnknowns, fit
from estimation.gap.fit.problem import LikelihoodProblem, Local, ModelFit
from estimation.gap.fit.whitener import Slack, Whitener
from estimation.gap.significance import tangent as tangents
from estimation.gap.significance.screen import gram_of, shared_prior
from estimation.gap.significance.tangent import Tangent
from tests.unit.estimation.gap.test_shared_solver import COUNT, problem

NULLS = 3
CHANGES = 4


def slackened() -> LikelihoodProblem:
    """The problem of two records whose whiteners forgive something, with some samples that were not measured."""
    plain = problem()
    rows = np.random.default_rng(4).standard_normal((plain.whiteners[0].root.shape[0] * 2, 5))
    made = tuple(Whitener(w.root, w.count, Slack(rows)) for w in plain.whiteners)
    for record in plain.records:
        record.z[7:9] = np.nan
    return LikelihoodProblem(plain.model, plain.base, plain.records, made, plain.criteria)


def drawn(many: int, seed: int) -> list[Array]:
    return list(np.random.default_rng(seed).standard_normal((many, COUNT, 1)))


def projected(bound: LikelihoodProblem, found: ModelFit, index: int, changes: list[Array], nulls: list[Array]) -> Array:
    """Gram matrix of [shared | changes | residuals] of one record with what is its own taken out by least squares, its priors as
    rows of their own."""
    residual, dy = bound.linearised(index, found.values, found.locals[index]) or (np.zeros(0), np.zeros(0))
    n, own = len(bound.free), dy.shape[2] - len(bound.free)
    block = np.concatenate([dy, *(c[:, :, None] for c in (*changes, residual, *nulls))], axis=2)
    block[~np.isfinite(residual)] = 0.0
    rows = bound.whiteners[index].rows(block)
    weights = [bound.prior(name) for name in bound.local_names]
    known = [(i, mean, std) for i, (mean, std) in enumerate(w for w in weights if w is not None)]
    believed = np.zeros((len(known), rows.shape[1]))
    for row, (i, mean, std) in enumerate(known):
        believed[row, n + i] = 1.0 / std
        believed[row, n + own + len(changes)] = (mean - found.locals[index].parameters[bound.local_names[i]]) / std
    rows = np.concatenate([rows, believed])
    inside, rest = rows[:, n : n + own], np.delete(rows, range(n, n + own), axis=1)
    left = rest - inside @ np.linalg.lstsq(inside, rest, rcond=None)[0]
    made, data = np.asarray(left.T @ left), n + len(changes)
    made[data, data] -= float(np.sum(believed[:, n + own + len(changes)] ** 2))  # a constant of the cost
    return made


def test_products_are_those_of_all_rows_with_what_is_a_records_own_taken_out() -> None:
    bound = slackened()
    found = fit(bound)
    nulls = tuple(tuple(drawn(2, 20 + k)) for k in range(NULLS))
    tangent = Tangent(bound, found, nulls)
    changes = [drawn(CHANGES, 5), drawn(CHANGES, 6)]
    each = [projected(bound, found, i, changes[i], [null[i] for null in nulls]) for i in range(2)]
    for i in range(2):
        record = tangent.record(i)
        np.testing.assert_allclose(record.gram_with(changes[i]), each[i], rtol=1e-7, atol=1e-6)
        columns = record.columns(changes[i])
        span = slice(len(bound.free), len(bound.free) + CHANGES)
        np.testing.assert_allclose(record.squares(columns), np.diag(each[i])[span], rtol=1e-8)
        some = columns.some([2, 0])
        np.testing.assert_allclose(record.products(some, columns), each[i][span, span][[2, 0]], rtol=1e-7, atol=1e-6)
    whole = sum(each) + shared_prior(bound, found, len(each[0]), CHANGES)
    np.testing.assert_allclose(gram_of(tangent, lambda i: changes[i]), whole, rtol=1e-7, atol=1e-6)


def test_without_changes_and_with_some_of_the_nulls_it_is_a_part_of_the_same() -> None:
    bound = slackened()
    found = fit(bound)
    nulls = tuple(tuple(drawn(2, 20 + k)) for k in range(NULLS))
    tangent, n = Tangent(bound, found, nulls), len(bound.free)
    whole = tangent.record(0).gram_with(drawn(CHANGES, 5))
    rest = [*range(n), *range(n + CHANGES, len(whole))]
    np.testing.assert_allclose(tangent.record(0).gram_with([]), whole[np.ix_(rest, rest)], rtol=1e-9, atol=1e-9)
    fewer = tangent.of(np.array([True, False, True])).record(0).gram
    kept = [*range(n + 1), n + 1, n + 3]
    np.testing.assert_allclose(fewer, tangent.record(0).gram[np.ix_(kept, kept)], rtol=1e-9, atol=1e-9)


def test_records_too_long_to_keep_are_made_anew_and_say_the_same(monkeypatch: pytest.MonkeyPatch) -> None:
    bound = slackened()
    found = fit(bound)
    kept = Tangent(bound, found)
    assert kept.record(1) is kept.record(1)
    monkeypatch.setattr(tangents, "CACHE", kept.record(0).size)
    short = Tangent(bound, found)
    assert short.record(0) is short.record(0)
    assert short.record(1) is not short.record(1)
    np.testing.assert_array_equal(short.record(1).gram, kept.record(1).gram)


def test_the_first_point_costs_what_any_other_does_and_steps_as_far() -> None:
    """With its derivatives from one run of the motion, or without."""
    bound = slackened()

    def view() -> ProblemUnknowns:
        return ProblemUnknowns(bound, bound.starts(), len(bound.free), (), np.zeros((len(bound.free),) * 2))

    first, second = view(), view()
    at = first.packed(tuple(Local(np.full(1, 0.3), local.parameters) for local in bound.starting_locals()))
    with_, without = first.evaluate(at, True), second.evaluate(at, False)
    assert len(with_.grams) == 2
    assert without.grams == ()
    assert with_.cost == pytest.approx(without.cost, rel=1e-12)
    for a, b in zip(with_.residuals, without.residuals, strict=True):
        np.testing.assert_array_equal(a, b)
    steps = [v.step(at, point, 0.0) for v, point in ((first, with_), (second, without), (first, with_))]
    for step in steps[1:]:  # the last: a second step from the same point, as after a step that led nowhere
        np.testing.assert_allclose(step.direction, steps[0].direction, rtol=1e-9, atol=1e-12)
        assert step.decrement == pytest.approx(steps[0].decrement)
    assert first.evaluate(at, True).grams == ()


def test_what_is_forgiven_is_what_unknowns_of_one_standard_deviation_do() -> None:
    rng = np.random.default_rng(9)
    E, rows = rng.standard_normal((40, 6)), rng.standard_normal((40, 3))
    slack = Slack(E)
    inverse = np.linalg.inv(np.eye(40) + E @ E.T)
    forgiven = slack.forgiven(rows)
    np.testing.assert_allclose(rows.T @ rows - forgiven.T @ forgiven, rows.T @ inverse @ rows, rtol=1e-9, atol=1e-9)
    root = np.eye(40) - E @ slack.mix @ E.T
    np.testing.assert_allclose(root @ root, inverse, atol=1e-12)
    assert np.linalg.eigvalsh(root).min() > 0.0


def test_large_columns_that_are_as_good_as_equal_are_forgiven_once() -> None:
    """I + E'E is singular to rounding then; what all of them do together is forgiven, and nothing else."""
    rng = np.random.default_rng(9)
    shape, rows = rng.standard_normal(40), rng.standard_normal((40, 3))
    alike = 1e8 * np.outer(shape, [1.0, 2.0, 3.0]) * (1.0 + 1e-13 * rng.standard_normal((40, 3)))
    with pytest.raises(np.linalg.LinAlgError):
        np.linalg.cholesky(np.eye(3) + alike.T @ alike)
    forgiven = Slack(alike).forgiven(rows)
    along = shape @ rows / np.linalg.norm(shape)
    np.testing.assert_allclose(forgiven.T @ forgiven, np.outer(along, along), rtol=1e-3, atol=1e-3)
    assert np.isfinite(Slack(alike).mix).all()
