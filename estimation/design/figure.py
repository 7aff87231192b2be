"""A designed manoeuvre on one page: inputs, their spectra, the motion against its limits, and the predicted bounds."""

from pathlib import Path
from typing import Any

import numpy as np

from daq.utilities.constants import RADIAN
from estimation.design.design import UNTOLD, InputDesign
from estimation.design.predict import INTEGRATION_STEP
from estimation.report.drawing.figures import save_figure, styled
from estimation.report.names import tex

_HIGHEST_HZ = 3.0  # of the spectra shown


def write_figure(input_design: InputDesign, path: Path) -> None:
    """Write the page to `path`, whose suffix gives the format."""
    from matplotlib.figure import Figure

    with styled():
        page = Figure(layout="constrained")
        _draw(page, input_design)
        save_figure(page, path, dpi=150)


def _draw(page: Any, input_design: InputDesign) -> None:
    controls, motion = input_design.setting.controls, input_design.best.motion
    limited = [u for u in input_design.best.used if u.name in motion.signals and u.name not in controls]
    rows = len(controls) + len(limited)
    page.set_size_inches(8.5, 1.3 * rows + 2.6)
    grid = page.add_gridspec(rows + 1, 2, width_ratios=(2, 1), height_ratios=(*(1.0,) * rows, 2.0))
    last = None
    for i, control in enumerate(controls):
        command = RADIAN * input_design.best.commands[:, i]
        last = page.add_subplot(grid[i, 0], sharex=last)
        last.plot(motion.time, command, color="C0", linewidth=1.0)
        last.set_ylabel(f"${tex(control)}$ [deg]")
        _spectrum(page.add_subplot(grid[i, 1]), command, last=i == len(controls) - 1)
    for j, use in enumerate(limited):
        last = page.add_subplot(grid[len(controls) + j, 0], sharex=last)
        _response(last, input_design, use.name, use.allowed)
    if last is not None:
        last.set_xlabel("time [s]")
    _bounds(page.add_subplot(grid[rows, :]), input_design)


def _spectrum(axes: Any, command: np.ndarray, last: bool) -> None:  # type: ignore[type-arg]
    frequency = np.fft.rfftfreq(command.size - 1, INTEGRATION_STEP)
    size = 2.0 * np.abs(np.fft.rfft(command[:-1])) / (command.size - 1)
    in_band = (frequency > 0.0) & (frequency <= _HIGHEST_HZ)
    axes.vlines(frequency[in_band], 0.0, size[in_band], color="C0", linewidth=1.5)
    axes.set_ylim(bottom=0.0)
    axes.set_ylabel("[deg]")
    if last:
        axes.set_xlabel("frequency [Hz]")


def _response(axes: Any, input_design: InputDesign, name: str, allowed: float) -> None:
    motion, limit = input_design.best.motion, input_design.limits.response[name]
    factor = 1.0 if name in ("V", "ax", "ay", "az") else RADIAN
    values = factor * motion.signals[name]
    middle = factor * 0.5 * (limit[0] + limit[1]) + (values[0] if limit[2] else 0.0)
    axes.plot(motion.time, values, color="C1", linewidth=1.0)
    for side in (-1.0, 1.0):
        axes.axhline(middle + side * factor * allowed, color="0.4", linewidth=0.8, linestyle="--")
    axes.set_ylabel(f"${tex(name)}$" + (" [deg]" if factor != 1.0 else ""))


def _bounds(axes: Any, input_design: InputDesign) -> None:
    names = list(input_design.relative)
    positions = np.arange(len(names))
    doublet_bounds = input_design.expected_of_doublets
    axes.bar(
        positions - 0.2,
        [100 * doublet_bounds[n] / abs(input_design.sizes[n]) for n in names],
        0.4,
        color="0.75",
        label="doublets",
    )
    axes.bar(positions + 0.2, [100 * input_design.relative[n] for n in names], 0.4, color="C0", label="this input")
    axes.axhline(100 * UNTOLD, color="C3", linewidth=0.8, linestyle="--", label="cannot tell above")
    axes.set_yscale("log")
    axes.set_xticks(positions, [f"${tex(n)}$" for n in names])
    axes.set_ylabel("predicted error (1 sigma) [%]")
    axes.legend(loc="upper right", ncols=3)
