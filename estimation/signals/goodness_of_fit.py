"""How well a model's outputs match measurements: per channel, with the parts of the misfit, and proof of match.

r2 = 1 - sum e^2 / sum (z - mean z)^2. Theil's inequality coefficient U = rms e / (rms z + rms y), 0 perfect, 1 hopeless,
below 0.25-0.3 usually called good; its squared error splits into bias, variance and covariance parts that add to one
(Jategaonkar, Flight Vehicle System Identification, 2nd ed., section 11.3). Whiteness: share of the residual
autocorrelations within +-1.96/sqrt(N) over lags up to a quarter of the record (0.95 expected of white noise).
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from daq.utilities.constants import NORMAL_95
from estimation.signals.denoise import noise_level

Array = NDArray[np.float64]

THEIL_LIMIT = 0.3
"""Theil's coefficient above which a channel without noise does not match: the upper end of what the literature calls good,
0.25 to 0.3."""
FEWEST_PAIRS = 3  # of samples: two always lie on a line


@dataclass(frozen=True, slots=True)
class ChannelFit:
    """Match of one channel; see the module head. samples: finite pairs. noise: Theil's coefficient of a perfect model, which
    measurement noise alone makes, estimated from the measurement."""

    r2: float
    theil: float
    theil_bias: float
    theil_variance: float
    theil_covariance: float
    rms: float
    whiteness: float
    samples: int
    noise: float = 0.0

    def limit(self, limit: float) -> float:
        """Largest acceptable Theil's coefficient. limit: for the misfit beyond the noise; squares of both add."""
        return float(np.hypot(limit, self.noise))

    def matches(self, limit: float) -> bool:
        """Whether the misfit beyond the noise is within a limit of Theil's coefficient; False where nothing was compared."""
        return self.theil <= self.limit(limit)

    def to_json(self) -> dict[str, float | int | None]:
        """Every field by name; JSON knows no NaN, so None stands for it."""
        values = {name: getattr(self, name) for name in self.__dataclass_fields__}
        return {name: value if np.isfinite(value) else None for name, value in values.items()}


def channel_fit(measured: Array, predicted: Array) -> ChannelFit:
    """Fit of one channel; (N,) each, pairs with a NaN left out. All NaN for fewer than FEWEST_PAIRS."""
    both_measured = np.isfinite(measured) & np.isfinite(predicted)
    z, y = measured[both_measured], predicted[both_measured]
    if z.size < FEWEST_PAIRS:
        nan = float("nan")
        return ChannelFit(nan, nan, nan, nan, nan, nan, nan, int(z.size))
    e = z - y
    mse = float(np.mean(e**2))
    spread = float(np.sum((z - z.mean()) ** 2))
    scale = float(np.sqrt(np.mean(z**2)) + np.sqrt(np.mean(y**2)))
    bias = float((z.mean() - y.mean()) ** 2)
    variance = float((z.std() - y.std()) ** 2)
    safe = mse if mse > 0 else 1.0
    return ChannelFit(
        r2=1.0 - float(np.sum(e**2)) / spread if spread > 0 else float("nan"),
        theil=float(np.sqrt(mse)) / scale if scale > 0 else 0.0,
        theil_bias=bias / safe,
        theil_variance=variance / safe,
        theil_covariance=max(0.0, 1.0 - (bias + variance) / safe) if mse > 0 else 0.0,
        rms=float(np.sqrt(mse)),
        whiteness=whiteness(e),
        samples=int(z.size),
        noise=noise_level(measured) / scale if scale > 0 else 0.0,
    )


def channel_fits(names: Sequence[str], measured: Array, predicted: Array) -> dict[str, ChannelFit]:
    """Fit of every channel; measured, predicted: (N, ny)."""
    return {name: channel_fit(measured[:, i], predicted[:, i]) for i, name in enumerate(names)}


def autocorrelation(residual: Array, lags: int) -> Array:
    """Biased autocorrelation (lags + 1,) of a residual (N,), NaN counted as zero, 1 at lag 0."""
    e = np.where(np.isfinite(residual), residual, 0.0)
    e = e - e.mean()
    size = 1 << int(np.ceil(np.log2(2 * e.size)))
    spectrum = np.abs(np.fft.rfft(e, size)) ** 2
    r = np.fft.irfft(spectrum, size)[: lags + 1]
    return r / r[0] if r[0] > 0 else np.zeros(lags + 1)


def whiteness(residual: Array) -> float:
    """Share of autocorrelations at lags 1 .. N/4 within the 95 % band of white noise."""
    count = residual.size
    lags = max(1, count // 4)
    r = autocorrelation(residual, min(lags, count - 1))[1:]
    return float(np.mean(np.abs(r) <= NORMAL_95 / np.sqrt(count))) if r.size else float("nan")


def to_json(fit: Mapping[str, ChannelFit]) -> dict[str, Any]:
    """The fit of every channel, for JSON."""
    return {name: f.to_json() for name, f in fit.items()}
