"""Residuals of a fit: over time, autocorrelation, spectrum, and against incidence, sideslip and surfaces."""

from typing import TYPE_CHECKING, Any

import numpy as np

from daq.utilities.constants import NORMAL_95
from estimation.estimators.result import FlightFit, Result
from estimation.report.drawing.figures import LARGE, Picture, broken_at_gaps, grid, look, picture, styled
from estimation.report.names import axis_label, face, tex
from estimation.signals.goodness_of_fit import autocorrelation
from groundstation.flight import Array

if TYPE_CHECKING:
    from estimation.models.base import Model
    from groundstation.flight import Flight

AGAINST = ("alpha", "beta", "delta_e", "delta_a", "delta_r")
BINS = 10  # equally filled: enough to show a bend, and each mean is over a tenth of the flight
FEWEST = 8  # samples from which a spectrum, a correlation or a bin is shown
MOST_LAGS = 100  # of an autocorrelation
SPECTRUM = 256  # samples of a stretch in Welch's method: frequencies 0.08 Hz apart at 20 Hz
ROW = 1.3  # height of a channel [inches]
MOVED = 1e-6  # rad, least standard deviation of a quantity that is shown


def residual_figure(model: "Model", result: Result) -> Picture:
    """Residuals of one flight, their autocorrelation and their spectrum, beside those of white noise."""
    fit = result.flights[0]
    colour = look(result.method).colour
    with styled():
        figure, axes = grid(len(model.outputs), 3, ROW, own_scales=True, width_ratios=(2.0, 1, 1), sharex="col")
        step = float(np.nanmedian(np.diff(fit.time)))
        for i, signal in enumerate(model.outputs):
            factor, unit = face(signal.name, signal.unit)
            residual = factor * _residual(fit, i)
            axes[i][0].plot(fit.time, broken_at_gaps(fit.time, residual), color=colour, lw=0.8)
            axes[i][0].axhline(0, color="k", lw=0.5)
            axes[i][0].set_ylabel(axis_label(signal.name, unit))
            finite_residual = residual[np.isfinite(residual)]
            if finite_residual.size > FEWEST:
                _correlation(axes[i][1], finite_residual, step, colour)
                _spectrum(axes[i][2], finite_residual, step, colour)
            axes[i][1].set_ylim(-0.6, 1.05)
        for column, (title, axis_text) in enumerate(
            (
                ("residual", "time [s]"),
                ("autocorrelation", "lag [s]"),
                ("spectrum, share of variance", "frequency [Hz]"),
            )
        ):
            axes[0][column].set_title(title)
            axes[-1][column].set_xlabel(axis_text)
    return picture(
        figure,
        f"residuals_{fit.name}",
        f"{fit.name}, {result.method}: residuals, their autocorrelation (band: 95 % of white "
        "noise) and power spectral density over its mean (dashed: white noise).",
        fit.time.size * len(model.outputs),
    )


def _residual(fit: FlightFit, i: int) -> Array:
    return fit.residuals[:, i] if i < fit.residuals.shape[1] else np.full(fit.time.size, np.nan)


def _correlation(axis: Any, residual: Array, step: float, colour: str) -> None:
    lags = min(residual.size // 4, MOST_LAGS)
    axis.vlines(step * np.arange(lags + 1), 0, autocorrelation(residual, lags), color=colour, lw=1.0)
    band = NORMAL_95 / np.sqrt(residual.size)
    axis.axhspan(-band, band, color="0.6", alpha=0.25, lw=0)


def spectrum(residual: Array, step: float) -> tuple[Array, Array]:
    """(frequency [Hz], power spectral density over its mean) of residuals (N,) sampled every `step` [s]; by Welch's method,
    without zero frequency. White noise has one everywhere."""
    from scipy.signal import welch

    frequency, density = welch(residual, 1.0 / step, nperseg=min(SPECTRUM, residual.size))
    mean = float(np.mean(density[1:]))
    return frequency[1:], density[1:] / mean if mean > 0.0 else density[1:]


def _spectrum(axis: Any, residual: Array, step: float, colour: str) -> None:
    frequency, density = spectrum(residual, step)
    axis.plot(frequency, density, color=colour, lw=0.9)
    axis.axhline(1.0, color="0.4", lw=0.8, ls="--")
    axis.set_yscale("log")
    axis.minorticks_off()
    axis.yaxis.set_major_formatter("{x:g}")
    axis.set_ylim(1e-2, max(30.0, 1.5 * float(density.max())))


def against_figure(model: "Model", result: Result, flight: "Flight") -> Picture | None:
    """Residuals of one flight against incidence, sideslip and the surfaces that moved, with means of equally filled bins;
    None where none of these was measured."""
    fit = result.flights[0]
    moved_columns = moved_quantities(result, flight)
    if not moved_columns:
        return None
    colour = look(result.method).colour
    points = fit.time.size * len(model.outputs) * len(moved_columns)
    with styled():
        figure, axes = grid(len(model.outputs), len(moved_columns), ROW, sharex="col", sharey="row")
        for i, signal in enumerate(model.outputs):
            factor, unit = face(signal.name, signal.unit)
            for j, column in enumerate(moved_columns):
                x = np.degrees(abscissa(model, fit, flight, column))
                axes[i][j].plot(x, factor * _residual(fit, i), ".", color=colour, ms=1.6, alpha=0.35)
                axes[i][j].errorbar(*binned(x, factor * _residual(fit, i)), color="k", fmt="o-", ms=2.4, lw=0.8)
                axes[i][j].axhline(0, color="0.4", lw=0.6)
                axes[-1][j].set_xlabel(f"${tex(column)}$ [deg]")
            axes[i][0].set_ylabel(axis_label(signal.name, unit))
    caption = (
        f"{fit.name}, {result.method}: residuals against incidence, sideslip and surfaces. Black: means of {BINS} equally filled "
        "bins with 95 % of what white noise of this size would leave; a bend that leaves them is a term the model lacks."
    )
    return picture(figure, f"against_{fit.name}", caption, points if points > LARGE else 0)


def moved_quantities(result: Result, flight: "Flight") -> list[str]:
    """Those of incidence, sideslip and surfaces that were measured and moved, at the samples of the fit."""
    same_samples = len(flight) == result.flights[0].time.size
    return [c for c in AGAINST if same_samples and flight.measured(c) and np.nanstd(flight[c]) > MOVED]


def abscissa(model: "Model", fit: FlightFit, flight: "Flight", column: str) -> Array:
    """(N,) abscissa of residuals: the model's output where the column is one, else the measured column. The noise of a measured
    output is also in its residual, and would show a bend for a perfect model."""
    outputs = [i for i, signal in enumerate(model.outputs) if signal.source == column and i < fit.outputs.shape[1]]
    return fit.outputs[:, outputs[0]] if outputs else flight[column]


def binned(x: Array, residual: Array) -> tuple[Array, Array, Array]:
    """(centres, means, 1.96 standard errors) of `residual` in equally filled bins of `x`; (N,) each, NaN left out."""
    finite = np.isfinite(x) & np.isfinite(residual)
    order = np.argsort(x[finite])
    x, residual = x[finite][order], residual[finite][order]
    parts = [p for p in np.array_split(np.arange(x.size), BINS) if p.size >= FEWEST]
    centres = np.array([x[p].mean() for p in parts])
    means = np.array([residual[p].mean() for p in parts])
    errors = np.array([NORMAL_95 * residual[p].std(ddof=1) / np.sqrt(p.size) for p in parts])
    return centres, means, errors
