"""`design`: an input for parameter estimation, with the predicted motion of the aircraft and the predicted bounds."""

import math
from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

from daq.utilities.input_files import read_json
from daq.utilities.outputs import write_text
from daq.utilities.plain_words import comma_separated
from estimation.answers.answer import Answer, Rows, panels, picture_writers
from estimation.answers.estimates import Estimates
from estimation.threads import single_threaded

if TYPE_CHECKING:
    from daq.contract.manoeuvre import Manoeuvre
    from estimation.design.design import DesignTask, InputDesign
    from estimation.models import Model
    from estimation.resolve import AnyAircraft, AnyModel, Names

CRUISE_LIFT = 0.3  # lift coefficient that sets the speed where none is given
HIGHEST_BAND_HZ = 25.0  # no actuator of a small aircraft follows faster inputs


@single_threaded
def design(
    model: "AnyModel",
    time: float,
    aircraft: "AnyAircraft" = None,
    kind: str = "optimal",
    *,
    estimate: "Estimates | str | Path | None" = None,
    limits: str | Path | None = None,
    separate: "Names" = (),
    criterion: str = "worst",
    controls: "Names" = (),
    band: tuple[float, float] = (0.1, 1.5),
    speed: float | None = None,
    density: float = 1.17,
    rate_hz: float = 20.0,
    held: bool = False,
    seed: int = 1,
    values: Mapping[str, float] | None = None,
    noise: Mapping[str, float] | None = None,
) -> "DesignAnswer":
    """Design the input of a given length that gives the smallest bounds.

    Args:
        model: "lateral", "lateral-simple", "longitudinal", "six-dof", a model file, "module:Class" or a Model.
        time: length of the input [s].
        aircraft: a built-in name or a file.
        kind: doublet, 121, 3211, chirp, multisine or optimal.
        estimate: an answer of `estimate`, or its JSON: its model, aircraft, values and noise replace those given here.
        limits: a LIMITS.toml.
        separate: two effects of the gap catalogue, or parameters, to separate.
        criterion: of kind optimal: worst, D, A, or the name of a parameter.
        controls: controls that move; by default all of the model.
        band: of chirps and multisines [Hz].
        speed: true airspeed [m/s]; by default the one for a lift coefficient of 0.3.
        density: of the air [kg/m3].
        rate_hz: samples a second.
        held: a pilot gently holds bank and pitch during the input.
        seed: of the search for phases.
        values: of parameters, instead of those of the aircraft file.
        noise: of outputs, one sigma, instead of that of usual instruments.

    Raises:
        EstimationError: one sentence, for an input that cannot be designed.

    Example::

        answer = ss.design("lateral", 20.0, "cdfp", kind="multisine")
        answer.save("multisine.toml")
    """
    from daq.utilities.constants import GRAVITY
    from estimation.design.design import DesignTask
    from estimation.design.design import design as design_input
    from estimation.design.limits import load_limits
    from estimation.resolve import resolve

    from_estimate = {} if estimate is None else _from_estimate(estimate)
    aircraft_name = aircraft or from_estimate.get("aircraft")
    _check(aircraft_name, band)
    problem = resolve([], from_estimate.get("model", model), aircraft_name)
    airframe = problem.aircraft
    task = DesignTask(
        kind=kind,
        duration=time,
        speed=speed or math.sqrt(2 * airframe.mass * GRAVITY / (density * airframe.area * CRUISE_LIFT)),
        density=density,
        controls=comma_separated(controls),
        band=band,
        criterion=criterion,
        values=from_estimate.get("values", values or {}),
        noise=from_estimate.get("noise", noise or {}),
        noise_of_residuals=bool(from_estimate),
        rate_hz=rate_hz,
        held=held,
        seed=seed,
    )
    loaded, task = _separating(problem.model, task, comma_separated(separate))
    return DesignAnswer(design_input(loaded, airframe, task, load_limits(Path(limits)) if limits else None))


def _check(aircraft: "AnyAircraft", band: tuple[float, float]) -> None:
    """Raise EstimationError without an aircraft, or for an impossible band [Hz]."""
    from estimation.errors import EstimationError

    if not aircraft:
        raise EstimationError(
            "design: name the aircraft with --aircraft (a built-in one or an AIRCRAFT.toml), or --from an estimate"
        )
    low, high = band
    if not 0.0 < low < high < HIGHEST_BAND_HZ:
        raise EstimationError(
            f"--band {low:g},{high:g}: give two frequencies in Hz, like 0.1,1.5 (at most {HIGHEST_BAND_HZ:g})"
        )


def _separating(model: "Model", task: "DesignTask", effects: tuple[str, ...]) -> "tuple[Model, DesignTask]":
    """Model and task for an input that separates the effects; unchanged without effects."""
    from estimation.errors import EstimationError

    if not effects:
        return model, task
    if task.kind != "optimal":
        raise EstimationError("--separate designs an optimal input: leave --kind out")
    model, sizes = with_effects(model, effects)
    return model, replace(task, separate=tuple(sizes), sizes=sizes)


@dataclass(frozen=True, repr=False)
class DesignAnswer(Answer):
    """The answer of `design`. design: commands, predicted motion and bounds."""

    design: "InputDesign"

    @property
    def relative(self) -> dict[str, float]:
        """Parameter -> predicted standard deviation over its size, for those with a size."""
        return self.design.relative

    def manoeuvre(self) -> "Manoeuvre":
        """The manoeuvre that flies this input."""
        return self.design.manoeuvre()

    def to_json(self) -> dict[str, Any]:
        return self.design.to_json()

    def lines(self) -> list[str]:
        return _lines(self.design)

    def plot(self, ax: Any = None) -> Any:
        """Draw commands over time, one axes a control [deg]; returns the axes."""
        time, commands = self.design.best.motion.time, self.design.best.commands
        axes = panels(ax, commands.shape[1])
        for panel, name, column in zip(axes, self.design.setting.controls, commands.T, strict=True):
            panel.plot(time, [math.degrees(v) for v in column])
            panel.set_ylabel(f"{name} [deg]")
        axes[-1].set_xlabel("time [s]")
        return axes

    def writers(self) -> Mapping[str, Callable[[Path], Any]]:
        """The manoeuvre as .toml, everything as .json, inputs, spectra, motion and bounds as a picture."""
        from estimation.design.figure import write_figure

        return {
            **super().writers(),
            ".toml": lambda path: write_manoeuvre(self.design, path),
            **picture_writers(lambda path: write_figure(self.design, path)),
        }

    def headline(self) -> str:
        return self.lines()[0]

    def rows(self) -> Rows:
        """A row for each parameter."""
        rows = [(n, f"{self.design.expected[n]:.2g}", f"{100 * r:.1f} %") for n, r in self.relative.items()]
        return ("parameter", "predicted std", "relative"), rows


def _lines(answer: "InputDesign") -> list[str]:
    """The printed lines."""
    task = answer.task
    lines = [
        f"{answer.best.kind} of {task.duration:g} s at {task.speed:.1f} m/s on {', '.join(answer.setting.controls)}: "
        f"worst relative error {_against_doublets(answer.gain)} than of doublets of equal length under the same limits"
    ]
    lines += [f"note: {note}" for note in answer.notes]
    peaks = answer.peak_factors()
    lines += ["", f"  {'control':<10}{'peak [deg]':>12}{'peak factor':>13}"]
    for i, control in enumerate(answer.setting.controls):
        peak = math.degrees(abs(answer.best.commands[:, i]).max())
        lines.append(f"  {control:<10}{peak:>12.2f}{peaks[control]:>13.3f}")
    lines += ["", f"  {'limit':<14}{'used':>10}{'allowed':>10}"]
    for use in answer.best.used:
        factor = 1.0 if use.name in ("load_factor", "V", "ax", "ay", "az") else math.degrees(1.0)
        unit = "" if factor == 1.0 else " deg"
        lines.append(f"  {use.name:<14}{factor * use.used:>10.2f}{factor * use.allowed:>10.2f}{unit}")
    lines += ["", f"  {'parameter':<12}{'size':>10}{'std':>10}{'relative':>10}{'doublets':>10}"]
    std_of_doublets, std = answer.expected_of_doublets, answer.expected
    for name, relative in answer.relative.items():
        size = answer.sizes[name]
        mark = "  cannot tell" if name in answer.untold else ""
        doublets = 100 * std_of_doublets[name] / abs(size)
        lines.append(f"  {name:<12}{size:>10.4g}{std[name]:>10.2g}{100 * relative:>9.1f}%{doublets:>9.1f}%{mark}")
    return lines


def _against_doublets(gain: float) -> str:
    return f"{gain:.2f} times smaller" if gain >= 1.0 else f"{1.0 / gain:.2f} times larger"


def write_manoeuvre(answer: "InputDesign", path: Path) -> None:
    """Write the file that `fly --manoeuvre` and the sequencer on board read."""
    import tomli_w

    write_text(tomli_w.dumps(answer.manoeuvre().to_dict()), path)


def with_effects(model: "Model", names: tuple[str, ...]) -> tuple["Model", dict[str, float]]:
    """The model with effects of the catalogue added, and the size of each of their parameters. A name may also be a parameter of
    the model. Raises EstimationError for fewer than two names, or one that the model cannot have."""
    from estimation.errors import EstimationError
    from estimation.gap.effects import catalogue

    if len(names) < 2:
        raise EstimationError("--separate needs two names or more, like Cn_da,Ixz_error")
    effects = {e.name: e for e in catalogue(model=model)}
    sizes: dict[str, float] = {}
    for name in names:
        if name in model.parameter_names:
            parameter = model.parameter(name)
            sizes[name] = abs(parameter.reference or parameter.start) or 1.0
            continue
        if name not in effects:
            raise EstimationError(
                f"--separate {name}: neither a parameter of model {model.name} nor an effect; see docs/effects.md"
            )
        form = next((f for f in effects[name].forms if f.obstacle(model) is None), None)
        if form is None:
            raise EstimationError(f"--separate {name}: {effects[name].forms[0].obstacle(model)}")
        # a delay or a play of zero has no slope: such effects are linearised at their typical size
        typical = {p.name: p.typical for p in form.parameters} if form.nonlinear else None
        model = form.added_to(model, typical)
        sizes |= {p.name: p.typical for p in form.parameters}
    return model, sizes


def _from_estimate(estimate: "Estimates | str | Path") -> dict[str, Any]:
    """Model, aircraft, values and noise of an estimate: the joint one where there is one, else of the first flight."""
    from estimation.aircraft.schema import aircraft_from_text
    from estimation.errors import EstimationError

    path = "the estimate" if isinstance(estimate, Estimates) else Path(estimate)
    try:
        content = (
            estimate.to_json()
            if isinstance(estimate, Estimates)
            else read_json(Path(estimate), "estimate", EstimationError)
        )
        methods = content["joint"] or content["flights"][0]["methods"]
        result = next(m for m in methods.values() if m["parameters"])
        # parameters that were not identifiable keep their beliefs where there are any
        values = {
            n: float(p["estimate"])
            for n, p in result["parameters"].items()
            if p["estimate"] is not None and (p["identifiable"] or p.get("reference") is None)
        }
        noise = {n: math.sqrt(v) for n, v in result["R"].items() if v}
        text = content.get("aircraft_file")
        aircraft = (
            aircraft_from_text(text, f"{path}, its aircraft", content["aircraft"]) if text else content["aircraft"]
        )
        return {"model": content["model"], "aircraft": aircraft, "values": values, "noise": noise}
    except OSError as error:
        raise EstimationError(f"{path}: cannot be read ({error.strerror}); name what estimate --json wrote") from error
    except (ValueError, KeyError, TypeError, IndexError, StopIteration, AttributeError, RecursionError) as error:
        raise EstimationError(f"{path}: not what 'sideslip estimate --json' writes, or without an estimate") from error
