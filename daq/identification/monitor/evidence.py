"""Whitening of innovations, and the score of each effect over the last seconds.

Whitening is a vector autoregression of second order, fitted to simulated flights. Predictions over long intervals, or over those
in which a surface moves, have larger errors, so every kind of interval has a covariance of its own; with a common one, surface
edges between the scans of a link dominate the tails of every score.

Whitened innovations are w = sum over effects of size * signature + noise. Sums over sliding windows: b = signatures' w,
C = signatures' signatures, energy w'w. Sizes of effects that the model contains (derivatives, constants) have priors, because no
model is exact and only a change beyond that counts. t seconds after a change, a window of w > t seconds gives sqrt(t / w) of the
score of a window of t seconds: long windows detect late, short ones detect large effects only. Several are therefore used.
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
AS_IF = 100.0  # scans of the common covariance that are added to those of each kind, which regularises rare kinds
PASSES = 3  # iterations, for weights and covariances depend on each other


@dataclass(frozen=True)
class Whitening:
    """w(t) = shape[kind] (e(t) - first e(t-1) - second e(t-2)), with unit covariance; zero where the kind is BLIND.
    first, second: (5, 5); shape: (kinds, 5, 5)."""

    first: Array
    second: Array
    shape: Array

    def applied(self, now: Array, before: Array, earlier: Array, kind: Kinds) -> Array:
        """The whitened innovations or signatures of a scan, from those of three in a row, each (5, ..., flights). kind:
        (flights,)."""
        residual = now - np.tensordot(self.first, before, 1) - np.tensordot(self.second, earlier, 1)
        return np.einsum("fij,j...f->i...f", self.shape[kind], residual)


Run = tuple[Array, Kinds]
"""Innovations (scans, 5, flights) and the kinds of their intervals (scans, flights), without gaps."""


def fit_whitening(runs: Iterable[Run]) -> Whitening:
    """Fit the whitening to runs of innovations: weighted least squares over all of them. The weight of a scan is that of its
    kind, from the covariance of the residuals, so that both are iterated."""
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
    """Covariance of the residuals of each kind, (kinds, 5, 5), and that of all, (5, 5)."""
    channels = first.shape[0]
    sums, counts = np.zeros((KINDS, channels, channels)), np.zeros(KINDS)
    for e, kinds in runs:
        residual = e[2:] - np.einsum("ij,tjf->tif", first, e[1:-1]) - np.einsum("ij,tjf->tif", second, e[:-2])
        flat, kind = residual.transpose(0, 2, 1).reshape(-1, channels), kinds[2:].ravel()
        for k in set(np.unique(kind).tolist()) - {BLIND}:
            residuals = flat[kind == k]
            sums[k] += residuals.T @ residuals
            counts[k] += len(residuals)
    common_covariance = sums.sum(axis=0) / counts.sum()
    return (sums + AS_IF * common_covariance) / (counts + AS_IF)[:, None, None], common_covariance


PIECE_S = 0.5  # s of scans that are summed before they enter a window: the resolution of its edges and of an onset
WINDOWS_S = (2.0, 4.5, 10.0)
"""Lengths of the windows [s], each a little more than twice the one before, so that at most a third of a score is lost."""
ENERGY_S = 5.0  # s over which the energy of a channel is averaged
SETTLED_S = 15.0  # s before those which the usual energy needs
MEMORY_S = 20.0  # s, time constant of the adaptation to this flight's air: few changes stay undetected for as long
BEFORE_S = 0.05  # s before a scan whose mean predicts it: up to 20 Hz one scan; two would take longer to learn
AIR_AS_IF = 40.0  # scans with unit covariance, as in the simulated air, that are added to those of this flight
TELLING = 0.2  # least share of the evidence of a channel that is named
TINY = 1e-12


@dataclass
class EvidenceSums:
    """Sums over PIECE_S. time: of the first scan [s]; b: (flights, effects); C: (flights, effects, effects); energy: (flights, 5)
    by channel, after the fitted whitening; total: (flights,) over all channels, after the adaptive whitening, as b and C are;
    scans: how many; shares: (5, effects, flights) of b by channel."""

    time: float
    b: Array
    C: Array
    energy: Array
    total: Array
    scans: int
    shares: Array


@dataclass(frozen=True)
class EffectScores:
    """z: (flights, windows, effects) size of each effect in standard deviations, by each of `WINDOWS_S`. unnamed: (flights, 5)
    energy of each channel over its usual energy; NaN before that is known."""

    z: Array
    unnamed: Array


class AirWhitening:
    """Adaptive whitening by the covariance of this flight's innovations, each with the one before it.

    Innovations that are white on average over the simulated flights are not in stronger gusts: these move sideslip, yaw rate and
    side force together, and at ten scans a second the yaw rate of one scan follows the sideslip of the last, which looks like a
    change of yawing derivatives. In calm air the scores would be smaller than they could be.
    """

    def __init__(self, channels: int, effects: int, flights: int) -> None:
        size = 2 * channels  # the earlier innovations, and the last
        self._channels, self._scans, self._time = channels, np.zeros((flights, 1, 1)), -math.inf
        self._products = np.zeros((flights, size, size))
        self._shape = np.broadcast_to(np.eye(size)[-channels:], (flights, channels, size))
        self._innovations, self._signatures = np.zeros((flights, size, 1)), np.zeros((flights, size, effects))

    def add(self, time: float, white: Array, signatures: Array) -> tuple[Array, Array]:
        """Whiten innovations (5, flights) and signatures (5, effects, flights) of a scan at `time` [s]; same shapes. A blind
        scan, all zero, does not change the covariance."""
        older, last = slice(None, self._channels), slice(self._channels, None)
        latest = min(1.0, (time - self._time) / BEFORE_S)  # weight of the last scan in the mean of the earlier ones
        self._time = time
        for past, now in ((self._innovations, white.T[:, :, None]), (self._signatures, signatures.transpose(2, 0, 1))):
            past[:, older] += latest * (past[:, last] - past[:, older])
            past[:, last] = now
        not_blind = np.any(white, axis=0)[:, None, None]
        self._products += not_blind * self._innovations * self._innovations.transpose(0, 2, 1)
        self._scans += not_blind
        whitened = (self._shape @ self._innovations)[:, :, 0].T * not_blind[:, 0, 0]
        return whitened, (self._shape @ self._signatures).transpose(1, 2, 0) * not_blind[:, 0, 0]

    def update(self) -> None:
        """Update the whitening after a piece, for the next ones, from the covariance so far."""
        fade = math.exp(-PIECE_S / MEMORY_S)
        self._products *= fade
        self._scans *= fade
        covariance = (self._products + AIR_AS_IF * np.eye(self._products.shape[1])) / (self._scans + AIR_AS_IF)
        # the last rows of the inverse triangle subtract the prediction by the earlier scans and whiten the remainder
        self._shape = np.linalg.inv(np.linalg.cholesky(covariance))[:, -self._channels :]


class MonitorEvidence:
    """Sliding windows over whitened innovations and signatures of several flights at once."""

    def __init__(self, effects: Sequence[MonitoredEffect]) -> None:
        self._prior = np.array([e.prior / e.step for e in effects])
        self._pieces: deque[EvidenceSums] = deque()
        self._open: EvidenceSums | None = None
        self._usual: Array | None = None  # sums of energy before the longest window
        self._usual_scans = 0
        self._air: AirWhitening | None = None

    def add(self, time: float, white: Array, signatures: Array) -> bool:
        """Add a scan at `time` [s]: innovations (5, flights) and signatures (5, effects, flights), whitened. Returns True when a
        piece of PIECE_S is complete."""
        energy = (white**2).T
        if self._air is None:
            self._air = AirWhitening(*signatures.shape)
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
        self._air.update()
        if len(self._pieces) > round(WINDOWS_S[-1] / PIECE_S):
            oldest = self._pieces.popleft()
            self._usual = oldest.energy if self._usual is None else self._usual + oldest.energy
            self._usual_scans += oldest.scans
        return True

    @property
    def seconds(self) -> float:
        """Flight time in the longest window [s]."""
        return PIECE_S * len(self._pieces)

    def forget(self) -> None:
        """Empty the windows; the usual energy stays."""
        self._pieces.clear()
        self._open = None

    def score(self) -> EffectScores:
        """The scores of all windows, each over the flight so far while that is shorter."""
        pieces = list(self._pieces)
        return EffectScores(
            np.stack([self._window_scores(pieces[-round(w / PIECE_S) :]) for w in WINDOWS_S], axis=1), self._energies()
        )

    def _window_scores(self, pieces: Sequence[EvidenceSums]) -> Array:
        """(flights, effects) scores over these pieces."""
        b = np.sum([p.b for p in pieces], axis=0)
        C = np.sum([p.C for p in pieces], axis=0)
        total = np.sum([p.total for p in pieces], axis=0)
        scans = sum(p.scans for p in pieces)
        z, explained = self._scores(b, C)
        noise_variance = np.maximum(total - explained, 0.0) / (pieces[0].energy.shape[1] * max(scans, 1))
        return np.asarray(z / np.sqrt(np.maximum(noise_variance, 1.0))[:, None])

    def _scores(self, b: Array, C: Array) -> tuple[Array, Array]:
        """(flights, effects) z of each effect, and (flights,) the energy that the best of them explains together with errors of
        the model."""
        modelled = np.flatnonzero(self._prior > 0.0)
        absent = np.flatnonzero(self._prior == 0.0)
        variance = self._prior[modelled] ** 2
        posterior = np.linalg.inv(C[:, modelled[:, None], modelled] + np.diag(1.0 / variance))
        mean = np.einsum("fij,fj->fi", posterior, b[:, modelled])
        z = np.zeros_like(b)
        posterior_variance = np.diagonal(posterior, axis1=1, axis2=2)
        # the posterior mean of a size drawn from the prior has variance prior - posterior
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
        """Indices of the channels with at least TELLING of the evidence for an effect, largest first."""
        shares = np.sum([p.shares[:, effect, flight] for p in self._pieces], axis=0)
        total = float(shares.sum())
        parts = shares / total if total else shares
        return tuple(int(i) for i in np.argsort(-parts) if parts[i] >= TELLING)

    def onset(self, flight: int, effect: int) -> tuple[float, float]:
        """Most likely onset of an effect within the longest window [s], and its size since then [steps]."""
        largest, onset_time, size, b, c = -1.0, self._pieces[-1].time, 0.0, 0.0, TINY
        for piece in reversed(self._pieces):
            b, c = b + piece.b[flight, effect], c + piece.C[flight, effect, effect]
            if b * b / c > largest:
                largest, onset_time, size = b * b / c, piece.time, b / c
        return onset_time, size
