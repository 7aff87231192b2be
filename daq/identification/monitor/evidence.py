"""Innovations made white, and what the last seconds of them say for each effect.

Whitening is a vector autoregression of second order, fitted to simulated flights. What a prediction over a long interval gets
wrong, or over one in which a surface moves, is larger than elsewhere, so every kind of interval has a covariance of its own;
with one for all, the edges between the scans of a link make the tails of every score.

Whitened innovations are w = sum over effects of size * signature + noise. Sums over sliding windows: b = signatures' w,
C = signatures' signatures, energy w'w. Sizes of what the model has (derivatives, constants) have priors: a model is never
exact, and a change is what goes beyond that. With t seconds behind a change, a window of w seconds gives sqrt(t / w) of the
score of one of t seconds: a long one is late to notice, a short one sees large effects only. So several are looked at.
"""

import math
from collections import deque
from collections.abc import Iterable, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from daq.identification.monitor.bank import MonitoredEffect
from daq.identification.monitor.surfaces import BLIND, KINDS, Kinds

Array = NDArray[np.float64]

ORDER = 2
AS_IF = 100.0  # scans of the usual covariance that are added to those of a kind: seldom ones are like all others
PASSES = 3  # weights and covariances need each other


@dataclass(frozen=True)
class Whitening:
    """w(t) = shape[kind] (e(t) - first e(t-1) - second e(t-2)), covariance one; nothing where the kind is blind.
    first, second: (5, 5); shape: (kinds, 5, 5)."""

    first: Array
    second: Array
    shape: Array

    def applied(self, now: Array, before: Array, earlier: Array, kind: Kinds) -> Array:
        """Three in a row, (5, ..., flights): the white one, same shape. kind: (flights,)."""
        rest = now - np.tensordot(self.first, before, 1) - np.tensordot(self.second, earlier, 1)
        return np.einsum("fij,j...f->i...f", self.shape[kind], rest)


Run = tuple[Array, Kinds]
"""Innovations (scans, 5, flights), and of each the kind of its interval (scans, flights)."""


def fitted(runs: Iterable[Run]) -> Whitening:
    """From stretches without gaps: least squares over all of them, each scan with the weight of its kind, whose covariance
    comes from what that leaves."""
    run_list = list(runs)
    weight = np.ones(KINDS)
    for _ in range(PASSES):
        weight[BLIND] = 0.0
        first, second = _autoregression(run_list, weight)
        covariance, common_covariance = _covariances(run_list, first, second)
        weight = len(common_covariance) / np.einsum("ij,kji->k", np.linalg.inv(common_covariance), covariance)
    shape = np.linalg.inv(np.linalg.cholesky(covariance))
    shape[BLIND] = 0.0
    return Whitening(first, second, shape)


def _autoregression(runs: Iterable[Run], weight: Array) -> tuple[Array, Array]:
    cross: Array | float = 0.0
    lagged_products: Array | float = 0.0
    for e, kind in runs:
        lagged = np.concatenate([e[1:-1], e[:-2]], axis=1)  # (scans - 2, 10, flights)
        weighted = lagged * weight[kind[2:]][:, None, :]
        cross = cross + np.einsum("tif,tjf->ij", e[2:], weighted)
        lagged_products = lagged_products + np.einsum("tif,tjf->ij", lagged, weighted)
    coefficients = np.linalg.solve(np.asarray(lagged_products), np.asarray(cross).T).T
    channels = coefficients.shape[0]
    return coefficients[:, :channels], coefficients[:, channels:]


def _covariances(runs: Iterable[Run], first: Array, second: Array) -> tuple[Array, Array]:
    """(kinds, 5, 5) of each kind, and the usual one."""
    channels = first.shape[0]
    sums, counts = np.zeros((KINDS, channels, channels)), np.zeros(KINDS)
    for e, kinds in runs:
        rest = e[2:] - np.einsum("ij,tjf->tif", first, e[1:-1]) - np.einsum("ij,tjf->tif", second, e[:-2])
        flat, kind = rest.transpose(0, 2, 1).reshape(-1, channels), kinds[2:].ravel()
        for k in set(np.unique(kind).tolist()) - {BLIND}:
            residuals = flat[kind == k]
            sums[k] += residuals.T @ residuals
            counts[k] += len(residuals)
    common_covariance = sums.sum(axis=0) / counts.sum()
    return (sums + AS_IF * common_covariance) / (counts + AS_IF)[:, None, None], common_covariance


PIECE_S = 0.5  # s of scans summed before they enter the window: how finely its edges, and an onset, are known
WINDOWS_S = (
    2.0,
    4.5,
    10.0,
)  # s of watched flight, a little more than twice the one before: at most a third of a score is lost
ENERGY_S = 5.0  # s over which a channel's energy is looked at
SETTLED_S = 15.0  # s of watched flight before those, which tell what the energy usually is
MEMORY_S = 20.0  # s over which innovations tell what they are in this air: few changes stay unnoticed for as long
BEFORE_S = 0.05  # s before a scan that tell of it, by their mean: up to 20 Hz one scan; two take longer to learn
AIR_AS_IF = 40.0  # scans of simulated air that those of this flight are added to
TELLING = 0.2  # share of the evidence from which a channel is named
TINY = 1e-12


@dataclass
class EvidenceSums:
    """Sums over half a second. time: of its first scan [s]; b: (flights, effects); C: (flights, effects, effects);
    energy: (flights, 5) by channel, as whitened by the calibration; total: (flights,) of all channels, whitened by this air as
    b and C are; scans: how many; shares: (5, effects, flights) of b by channel."""

    time: float
    b: Array
    C: Array
    energy: Array
    total: Array
    scans: int
    shares: Array


@dataclass(frozen=True)
class EffectScores:
    """(flights, windows, effects) z: how far each effect is from nothing, in standard deviations, by each of `WINDOWS_S`.
    unnamed: (flights, 5) energy of each channel against what it was before; NaN before that is known."""

    z: Array
    unnamed: Array


class InnovationsOfAir:
    """Whitening anew, by what innovations have been in this flight, each with the one before it. What is white in the air and
    with the instruments of the simulated flights on average is not in stronger gusts: they move sideslip, yaw rate and side
    force together, and at ten scans a second the yaw rate of one scan follows the sideslip of the last, all of which looks like
    changes of yawing derivatives; in calm air less would be seen than could be."""

    def __init__(self, channels: int, effects: int, flights: int) -> None:
        size = 2 * channels  # those before, and the last
        self._channels, self._scans, self._time = channels, np.zeros((flights, 1, 1)), -math.inf
        self._products = np.zeros((flights, size, size))
        self._shape = np.broadcast_to(np.eye(size)[-channels:], (flights, channels, size))
        self._innovations, self._signatures = np.zeros((flights, size, 1)), np.zeros((flights, size, effects))

    def add(self, time: float, white: Array, signatures: Array) -> tuple[Array, Array]:
        """Both anew, as they are given. Nothing is learnt of a blind scan."""
        older, last = slice(None, self._channels), slice(self._channels, None)
        latest, self._time = min(1.0, (time - self._time) / BEFORE_S), time  # part of the last scan in those before
        for past, now in ((self._innovations, white.T[:, :, None]), (self._signatures, signatures.transpose(2, 0, 1))):
            past[:, older] += latest * (past[:, last] - past[:, older])
            past[:, last] = now
        seen = np.any(white, axis=0)[:, None, None]
        self._products += seen * self._innovations * self._innovations.transpose(0, 2, 1)
        self._scans += seen
        anew = (self._shape @ self._innovations)[:, :, 0].T * seen[:, 0, 0]
        return anew, (self._shape @ self._signatures).transpose(1, 2, 0) * seen[:, 0, 0]

    def renew(self) -> None:
        """After a piece: from the next on what it has told counts as well."""
        fade = math.exp(-PIECE_S / MEMORY_S)
        self._products *= fade
        self._scans *= fade
        covariance = (self._products + AIR_AS_IF * np.eye(self._products.shape[1])) / (self._scans + AIR_AS_IF)
        # of the last rows of the triangle's inverse: what the scans before tell is subtracted, the rest made white
        self._shape = np.linalg.inv(np.linalg.cholesky(covariance))[:, -self._channels :]


class MonitorEvidence:
    """Sliding window over whitened innovations and signatures of several flights at once."""

    def __init__(self, effects: Sequence[MonitoredEffect]) -> None:
        self._prior = np.array([e.prior / e.step for e in effects])
        self._pieces: deque[EvidenceSums] = deque()
        self._open: EvidenceSums | None = None
        self._usual: Array | None = None  # sums of energy before the window
        self._usual_scans = 0
        self._air: InnovationsOfAir | None = None

    def add(self, time: float, white: Array, signatures: Array) -> bool:
        """One scan: (5, flights) and (5, effects, flights); True when half a second is complete."""
        energy = (white**2).T
        if self._air is None:
            self._air = InnovationsOfAir(*signatures.shape)
        white, signatures = self._air.add(time, white, signatures)
        shares = white[:, None, :] * signatures
        b = shares.sum(axis=0).T
        C = np.einsum("cef,cgf->feg", signatures, signatures)
        total = (white**2).sum(axis=0)
        if self._open is None:
            self._open = EvidenceSums(time, b, C, energy, total, 1, shares)
            return False
        p = self._open
        p.b = p.b + b
        p.shares = p.shares + shares
        p.C += C
        p.energy = p.energy + energy
        p.total = p.total + total
        p.scans += 1
        if time - p.time < PIECE_S - 0.026:  # half a scan, so that pieces do not drift by one
            return False
        self._pieces.append(p)
        self._open = None
        self._air.renew()
        if len(self._pieces) > round(WINDOWS_S[-1] / PIECE_S):
            oldest = self._pieces.popleft()
            self._usual = oldest.energy if self._usual is None else self._usual + oldest.energy
            self._usual_scans += oldest.scans
        return True

    @property
    def seconds(self) -> float:
        """Watched time in the window."""
        return PIECE_S * len(self._pieces)

    def forget(self) -> None:
        """Begin anew; what energy is usual is kept."""
        self._pieces.clear()
        self._open = None

    def score(self) -> EffectScores:
        """Of the windows as they are: as long as what has been watched, while that is less."""
        pieces = list(self._pieces)
        return EffectScores(
            np.stack([self._seen(pieces[-round(w / PIECE_S) :]) for w in WINDOWS_S], axis=1), self._energies()
        )

    def _seen(self, pieces: Sequence[EvidenceSums]) -> Array:
        """(flights, effects) scores by some of the pieces."""
        b = np.sum([p.b for p in pieces], axis=0)
        C = np.sum([p.C for p in pieces], axis=0)
        total = np.sum([p.total for p in pieces], axis=0)
        scans = sum(p.scans for p in pieces)
        z, explained = self._scores(b, C)
        noise_variance = np.maximum(total - explained, 0.0) / (pieces[0].energy.shape[1] * max(scans, 1))
        return np.asarray(z / np.sqrt(np.maximum(noise_variance, 1.0))[:, None])

    def _scores(self, b: Array, C: Array) -> tuple[Array, Array]:
        """z of each effect, and the energy that the best of them explains with the model's own errors."""
        modelled = np.flatnonzero(self._prior > 0.0)
        absent = np.flatnonzero(self._prior == 0.0)
        variance = self._prior[modelled] ** 2
        posterior = np.linalg.inv(C[:, modelled[:, None], modelled] + np.diag(1.0 / variance))
        mean = np.einsum("fij,fj->fi", posterior, b[:, modelled])
        z = np.zeros_like(b)
        posterior_variance = np.diagonal(posterior, axis1=1, axis2=2)
        # the posterior mean of what is drawn from the prior has variance prior - posterior
        z[:, modelled] = mean / np.sqrt(np.maximum(variance - posterior_variance, TINY * variance))
        coupling = C[:, absent[:, None], modelled]
        residual = b[:, absent] - np.einsum("foi,fi->fo", coupling, mean)
        spread = np.diagonal(C[:, absent[:, None], absent], axis1=1, axis2=2) - np.einsum(
            "foi,fij,foj->fo", coupling, posterior, coupling
        )
        z[:, absent] = residual / np.sqrt(np.maximum(spread, TINY))
        model_energy = np.einsum("fi,fi->f", b[:, modelled], mean)
        return z, np.asarray(model_energy + np.max(z**2, axis=1))

    def _energies(self) -> Array:
        last = list(self._pieces)[-round(ENERGY_S / PIECE_S) :]
        earlier = list(self._pieces)[: -round(ENERGY_S / PIECE_S)]
        energy = np.sum([p.energy for p in last], axis=0) / sum(p.scans for p in last)
        scans = self._usual_scans + sum(p.scans for p in earlier)
        sums = [p.energy for p in earlier] + ([] if self._usual is None else [self._usual])
        pieces = len(earlier) + self._usual_scans / max(last[0].scans, 1)
        if pieces * PIECE_S < SETTLED_S or not sums:
            return np.full_like(energy, np.nan)
        return np.asarray(energy / np.maximum(np.sum(sums, axis=0) / scans, 1.0))

    def channels(self, flight: int, effect: int) -> tuple[int, ...]:
        """Numbers of the channels whose errors show an effect, the most telling first: those with at least a fifth of it."""
        shares = np.sum([p.shares[:, effect, flight] for p in self._pieces], axis=0)
        total = float(shares.sum())
        parts = shares / total if total else shares
        return tuple(int(i) for i in np.argsort(-parts) if parts[i] >= TELLING)

    def onset(self, flight: int, effect: int) -> tuple[float, float]:
        """Since when the effect is there [s], as far as the window tells, and its size since then [steps]: the begin that
        makes it most likely."""
        largest, onset_time, size, b, c = -1.0, self._pieces[-1].time, 0.0, 0.0, TINY
        for piece in reversed(self._pieces):
            b, c = b + piece.b[flight, effect], c + piece.C[flight, effect, effect]
            if b * b / c > largest:
                largest, onset_time, size = b * b / c, piece.time, b / c
        return onset_time, size
