"""Bode plot with coherence: magnitude [dB], phase [deg] and coherence over a logarithmic frequency axis."""

from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from daq.utilities.constants import NORMAL_95
from estimation.frequency.response import FrequencyResponse
from estimation.frequency.transfer import GOOD, TransferFunction
from estimation.report.drawing.figures import ABOVE, Picture, picture, save_figure, styled
from estimation.report.names import literal, tex

if TYPE_CHECKING:
    from matplotlib.figure import Figure

DATA, FIT, OUT = "#0072B2", "#D55E00", "#9aa3ad"
SPLIT = 1.35  # ratio of neighbouring frequencies above which points between them were left out


def draw(response: FrequencyResponse, fit: TransferFunction | None = None) -> "Figure":
    from matplotlib.figure import Figure

    figure = Figure(figsize=(7.6, 7.4), layout="constrained")
    axes = figure.subplots(3, 1, sharex=True, height_ratios=(3, 3, 1.6))
    draw_on(axes, response, fit)
    figure.align_ylabels()
    return figure


def draw_on(axes: Any, response: FrequencyResponse, fit: TransferFunction | None = None) -> None:
    """Magnitude, phase and coherence on three axes."""
    omega = response.omega
    relative = NORMAL_95 * response.std / response.magnitude
    decibels, degrees = 20 * np.log10(response.magnitude), np.degrees(response.phase)
    upper_error, lower_error = 20 * np.log10(1 + relative), 20 * np.log10(np.maximum(1 - relative, 0.1))
    _banded(axes[0], omega, decibels, decibels + lower_error, decibels + upper_error)
    wide = NORMAL_95 * np.degrees(response.std_phase)
    _banded(axes[1], omega, degrees, degrees - wide, degrees + wide)
    if fit is not None:
        _fit(axes, response, fit)
    _coherence(axes[2], response)
    axes[0].set_ylabel(f"${tex(response.output)} / {tex(response.input)}$ magnitude [dB]")
    axes[1].set_ylabel("phase [deg]")
    axes[1].yaxis.set_major_locator(_multiples_of_45())
    axes[2].set_xlabel("frequency [rad/s]")
    axes[2].set_xscale("log")
    axes[2].xaxis.set_major_formatter(_plain_ticks())
    for axis in axes:
        axis.grid(which="minor", axis="x", alpha=0.15)
    axes[0].legend(ncols=3, **ABOVE)


def _banded(axis: Any, omega: Any, values: Any, low: Any, high: Any) -> None:
    """Points with their band, broken where points were left out."""
    breaks = np.flatnonzero(omega[1:] > SPLIT * omega[:-1]) + 1
    for k, part in enumerate(np.split(np.arange(omega.size), breaks)):
        label = ("flight", "random error, 95 %") if k == 0 else (None, None)
        axis.fill_between(omega[part], low[part], high[part], color=DATA, alpha=0.18, lw=0, label=label[1])
        axis.plot(omega[part], values[part], ".-", color=DATA, ms=4, lw=0.8, label=label[0])


def _fit(axes: Any, response: FrequencyResponse, fit: TransferFunction) -> None:
    omega = np.geomspace(*fit.omega, 300)
    H = fit.at(omega)
    phase = np.unwrap(np.angle(H))
    middle = float(np.median(np.interp(response.omega, omega, phase) - response.phase))
    phase -= 2 * np.pi * round(middle / (2 * np.pi))
    axes[0].plot(omega, 20 * np.log10(np.abs(H)), color=FIT, lw=1.3, label=f"fit, {literal(fit.form.name)}")
    axes[1].plot(omega, np.degrees(phase), color=FIT, lw=1.3)


def _coherence(axis: Any, response: FrequencyResponse) -> None:
    axis.plot(response.omega, response.coherence, ".", color=DATA, ms=4)
    if response.left_out:
        axis.plot(*zip(*response.left_out, strict=True), "x", color=OUT, ms=4, label="left out")
        axis.legend(loc="lower left")
    axis.axhline(GOOD, color="k", lw=0.7, ls="--")
    axis.set_ylim(0.0, 1.03)
    axis.set_ylabel("partial coherence" if len(response.inputs) > 1 else "coherence")


def _multiples_of_45() -> Any:
    from matplotlib.ticker import MaxNLocator

    return MaxNLocator(nbins=7, steps=[1, 1.5, 3, 4.5, 9, 10])


def _plain_ticks() -> Any:
    from matplotlib.ticker import FuncFormatter

    return FuncFormatter(lambda value, _: f"{value:g}")


def write_figure(response: FrequencyResponse, fit: TransferFunction | None, path: Path) -> None:
    with styled():
        save_figure(draw(response, fit), path, dpi=150)


def response_picture(response: FrequencyResponse, fit: TransferFunction | None) -> Picture:
    with styled():
        figure = draw(response, fit)
    caption = (
        f"Frequency response of {response.output} to {response.input}{response.conditioned}."
        f" Dashed: coherence {GOOD:g}, from which points are fitted."
    )
    return picture(figure, "frequency_response", caption)
