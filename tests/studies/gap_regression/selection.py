"""Which effect a regression names: stepwise regression and PySINDy's STLSQ, by their own rules and standardised on nulls.

A library column has one coefficient in all equations (`joint`, the weights between the equations given by physics), or a
coefficient of its own in every equation where an effect of usual size would show (`apart`, as regressions are usually
done). In every case the base terms are part of the model and only the library is selected from. The first name is what
counts: the largest partial F, the largest coefficient, the largest score. What a method would add after it is not held
against it.
"""

import warnings
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from estimation.gap.significance.calibration import upper_quantile
from tests.studies.gap_regression.equations import EQUATIONS
from tests.studies.gap_regression.library import LIBRARY, Array

SHOWS = 0.02  # of the residual's rms: what a column of usual size must leave beside the base terms to be in an equation
LEVEL = 0.95  # family-wise, of the largest score on the nulls
RIDGES = (0.05, 0.5, 2.0, 5.0)  # of STLSQ, columns and left side of norm one
CUTS = (0.02, 0.05, 0.1, 0.15, 0.2, 0.3, 0.4, 0.6)  # thresholds of STLSQ, in shares of what one lone column could reach
BISECTIONS = 4


@dataclass(frozen=True)
class Regression:
    """Normal equations of one set of flights and of its nulls.

    grams: (1 + nulls, n + 1, n + 1), of the flights first, the left side last; every column divided by its norm on the
    flights themselves. effects: of the n columns. freedom: residual degrees of freedom.
    """

    grams: Array
    effects: tuple[str, ...]
    freedom: int

    @classmethod
    def joint(cls, evidence: Array, samples: int) -> "Regression":
        """All equations stacked. evidence: (1 + nulls, equations, n + 1, n + 1)."""
        return cls._scaled(evidence.sum(axis=1), [h.effect for h in LIBRARY], samples * len(EQUATIONS))

    @classmethod
    def apart(cls, evidence: Array, samples: int) -> "Regression":
        """A column for every hypothesis and equation. Errors of the gyro are left to the kinematics: in the equations of
        moments their columns would be the left side itself, noise included, and always win."""
        own = np.diagonal(evidence[0], axis1=1, axis2=2)[:, :-1].copy()  # (equations, n)
        own[np.ix_([EQUATIONS.index("Cl"), EQUATIONS.index("Cn")], [h.rates for h in LIBRARY])] = 0.0
        places = [(e, j) for e in range(len(EQUATIONS)) for j in np.flatnonzero(own[e] > SHOWS**2 * samples)]
        grams = np.zeros((len(evidence), len(places) + 1, len(places) + 1))
        grams[:, -1, -1] = evidence[:, :, -1, -1].sum(axis=1)
        for a, (e, j) in enumerate(places):
            grams[:, a, -1] = grams[:, -1, a] = evidence[:, e, j, -1]
            for b, (f, i) in enumerate(places):
                if e == f:
                    grams[:, a, b] = evidence[:, e, j, i]
        return cls._scaled(grams, [LIBRARY[j].effect for _, j in places], samples * len(EQUATIONS))

    @classmethod
    def _scaled(cls, grams: Array, effects: Sequence[str], samples: int) -> "Regression":
        norm = np.sqrt(np.diagonal(grams[0]))
        norm = np.where(norm > 0.0, norm, 1.0)
        return cls(grams / norm / norm[:, None], tuple(effects), samples - 30)

    @property
    def projections(self) -> tuple[Array, Array, Array]:
        """(1 + nulls, n) norm squared of each column and product with the left side; (1 + nulls,) left side squared."""
        own = np.diagonal(self.grams, axis1=1, axis2=2)[:, :-1]
        return np.maximum(own, 1e-12), self.grams[:, :-1, -1], self.grams[:, -1, -1]

    def rows(self, which: int, ridge: float) -> tuple[Array, Array]:
        """Columns and left side with the same normal equations, ridge included: (2 n + 1, n) and (2 n + 1,)."""
        values, vectors = np.linalg.eigh(self.grams[which])
        root = np.sqrt(np.maximum(values, 0.0))[:, None] * vectors.T
        n = len(self.effects)
        return np.vstack([root[:, :-1], np.sqrt(ridge) * np.eye(n)]), np.concatenate([root[:, -1], np.zeros(n)])


@dataclass(frozen=True)
class Answer:
    """An effect, and by which factor what speaks for it passes its limit (named from 1 on)."""

    effect: str
    margin: float


def stepwise(r: Regression) -> Answer:
    """Largest partial F (margin: F itself, the limit is the reader's)."""
    own, product, whole = r.projections
    gain = product[0] ** 2 / own[0]
    best = int(np.argmax(gain))
    return Answer(r.effects[best], float(gain[best] / ((whole[0] - gain[best]) / r.freedom)))


def stepwise_on_nulls(r: Regression) -> dict[str, Answer]:
    """Coefficients in standard deviations from their mean on the nulls; named is the largest of these, or of those that
    pass the limit the one of largest partial F."""
    own, product, _ = r.projections
    coefficient = product / own
    calm = coefficient[1:]
    z = np.abs(coefficient - calm.mean(axis=0)) / calm.std(axis=0, ddof=1)
    limit = upper_quantile(z[1:].max(axis=1), LEVEL)
    gain = np.where(z[0] > limit, product[0] ** 2 / own[0], 0.0)
    by_score, by_gain = int(np.argmax(z[0])), int(np.argmax(gain))
    margin = float(z[0].max() / limit)
    return {"score": Answer(r.effects[by_score], margin), "partial F": Answer(r.effects[by_gain], margin)}


def stlsq(r: Regression) -> dict[str, str]:
    """What PySINDy's STLSQ names at each ridge and threshold: the largest coefficient that is left, or nothing."""
    found = {}
    for ridge in RIDGES:
        X, y = r.rows(0, 0.0)
        for cut in CUTS:
            left = np.abs(_coefficients(X, y, cut / (1.0 + ridge), ridge))
            found[f"ridge {ridge:g}, threshold {cut:g}"] = r.effects[int(np.argmax(left))] if left.any() else ""
    return found


def stlsq_on_nulls(r: Regression, ridge: float) -> Answer:
    """STLSQ with every coefficient in standard deviations from its mean on the nulls, thresholded family-wise."""
    rows = [r.rows(k, ridge) for k in range(len(r.grams))]
    full = np.array([np.linalg.lstsq(X, y, rcond=None)[0] for X, y in rows])
    mean, spread = full[1:].mean(axis=0), full[1:].std(axis=0, ddof=1)
    scaled = [(X * spread, y - X @ mean) for X, y in rows]
    limit = upper_quantile(np.array([_last_cut(X, y) for X, y in scaled[1:]]), LEVEL)
    highest = _last_cut(*scaled[0])
    left = np.abs(_coefficients(*scaled[0], min(limit, 0.999 * highest), 0.0))
    return Answer(r.effects[int(np.argmax(left))], highest / limit)


def _last_cut(X: Array, y: Array) -> float:
    """The highest threshold at which any coefficient is left, to some 2 %."""
    high = 1.001 * float(np.abs(np.linalg.lstsq(X, y, rcond=None)[0]).max())
    low = 0.3 * high
    while _coefficients(X, y, high, 0.0).any():  # leaving others out has made one larger
        low, high = high, 1.5 * high
    for _ in range(BISECTIONS):
        middle = 0.5 * (low + high)
        low, high = (middle, high) if _coefficients(X, y, middle, 0.0).any() else (low, middle)
    return low


def _coefficients(X: Array, y: Array, threshold: float, ridge: float) -> Array:
    """(n,) of PySINDy's STLSQ. Its last unregularised fit is left out: on columns this much alike it undoes the ridge."""
    from pysindy import STLSQ

    with warnings.catch_warnings():
        warnings.simplefilter("ignore")  # it warns wherever nothing is left, which is an answer here
        return np.asarray(STLSQ(threshold=threshold, alpha=max(ridge, 1e-12), unbias=False).fit(X, y).coef_[0])
