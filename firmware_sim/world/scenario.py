"""A scenario: everything that decides a simulated flight, as a TOML file.

The tables flown here are [flight], [wind], [derivatives], [[manoeuvre]], [[hidden]], [ground] and [site]; the tables
[sensors], [[faults]], [radio], [logger] and [sequencer] belong to instruments, bus, radio, logger and cockpit, and are passed
through as they stand.
"""

from collections.abc import Mapping
from pathlib import Path
from typing import Any

from pydantic import BaseModel, ConfigDict, Field, field_validator, model_validator

from daq.utilities.input_files import read_toml
from daq.utilities.plain_words import did_you_mean, file_name
from estimation.aircraft import load_aircraft
from firmware_sim.physics.aerodynamics import simulation_of
from firmware_sim.pilot.manoeuvres import AXES, MANOEUVRE_SETS, SHAPES, Axis, Shape, StickInput
from firmware_sim.tables import ScenarioError, checked, toml_text

BUILT_IN_FOLDER = Path(__file__).parents[1] / "scenarios"


class _ScenarioTable(BaseModel):
    model_config = ConfigDict(extra="forbid", frozen=True, allow_inf_nan=False, ser_json_inf_nan="constants")


class FlightTable(_ScenarioTable):
    """[flight]: how long, how fast, how high, which plan."""

    aircraft: str = "cdfp"
    duration_s: float = Field(default=30.0, gt=0.0, le=7200.0)
    speed_m_s: float = Field(default=17.0, gt=0.0, description="left out: the speed the aircraft is trimmed at")
    height_m: float = Field(default=60.0, ge=5.0, le=3000.0)
    heading_deg: float = 40.0
    seed: int = Field(default=1, ge=0)
    manoeuvres: str = "rich"
    repeat_every_s: float = Field(default=30.0, gt=0.0)
    hand_deg: float = Field(default=0.0, ge=0.0, le=2.0, description="unsteadiness of the pilot's hand, 1 sigma")
    derivative_scatter: float = Field(
        default=0.0, ge=0.0, le=0.5, description="true derivatives off by up to this fraction"
    )
    derivative_seed: int | None = Field(
        default=None, ge=0, description="same number, same aircraft; the flight's seed by default"
    )
    integration_hz: int = Field(default=200, ge=200, le=2000, multiple_of=50)

    @field_validator("manoeuvres")
    @classmethod
    def _known_set(cls, name: str) -> str:
        if name not in MANOEUVRE_SETS:
            raise ValueError(f"no such set of manoeuvres; known are {', '.join(MANOEUVRE_SETS)}")
        return name


class WindTable(_ScenarioTable):
    """[wind]: steady wind and gusts. gust_deg is the sideslip angle of the lateral gust at trim speed, 1 sigma."""

    speed_m_s: float = Field(default=0.0, ge=0.0, le=15.0)
    from_deg: float = 0.0
    gust_deg: float = Field(default=0.0, ge=0.0, le=3.0)


class GroundTable(_ScenarioTable):
    """[ground]: stillness before and after the flight; launch and landing are scripted, not flown."""

    before_s: float = Field(default=0.0, ge=0.0)
    after_s: float = Field(default=0.0, ge=0.0)
    launch_s: float = Field(default=25.0, ge=8.0)
    landing_s: float = Field(default=25.0, ge=8.0)


class SiteTable(_ScenarioTable):
    """[site]: place and weather of the field; see atmosphere.Site."""

    latitude_deg: float = Field(default=26.51, ge=-85.0, le=85.0)
    longitude_deg: float = Field(default=80.23, ge=-180.0, le=180.0)
    elevation_m: float = Field(default=0.0, ge=-300.0, le=4000.0)
    temperature_offset_k: float = Field(default=11.8, ge=-60.0, le=40.0)


class ManoeuvreTable(_ScenarioTable):
    """[[manoeuvre]]: one stick input; given any, they replace the set of [flight]."""

    axis: Axis
    shape: Shape
    start_s: float = Field(ge=0.0)
    amplitude: float = Field(description="degrees of surface, or throttle 0..1")
    width_s: float = Field(gt=0.0)
    harmonics: tuple[int, ...] = ()

    @model_validator(mode="after")
    def _multisine_has_harmonics(self) -> "ManoeuvreTable":
        if self.shape == "multisine" and not self.harmonics:
            raise ValueError("a multisine needs harmonics")
        return self

    def manoeuvre(self) -> StickInput:
        """As flown."""
        return StickInput(self.axis, self.shape, self.start_s, self.amplitude, self.width_s, self.harmonics)


class HiddenTable(_ScenarioTable):
    """[[hidden]]: a hidden effect by name, and its size as a multiple of the typical one."""

    name: str
    size: float = 1.0


class Scenario(_ScenarioTable):
    """A whole scenario; see the tables."""

    name: str = "unnamed"
    title: str = ""
    flight: FlightTable = FlightTable()
    wind: WindTable = WindTable()
    ground: GroundTable = GroundTable()
    site: SiteTable = SiteTable()
    derivatives: Mapping[str, float] = Field(default_factory=dict)
    manoeuvre: tuple[ManoeuvreTable, ...] = ()
    hidden: tuple[HiddenTable, ...] = ()
    sensors: Mapping[str, Any] = Field(default_factory=dict)
    faults: tuple[Mapping[str, Any], ...] = ()
    radio: Mapping[str, Any] = Field(default_factory=dict)
    logger: Mapping[str, Any] = Field(default_factory=dict)
    sequencer: Mapping[str, Any] | None = None

    @field_validator("name")
    @classmethod
    def _names_a_folder(cls, name: str) -> str:
        if name != file_name(name):
            raise ValueError("give a short name without slash and control characters: the flight's folder is called so")
        return name

    @field_validator("hidden")
    @classmethod
    def _known_effects(cls, hidden: tuple[HiddenTable, ...]) -> tuple[HiddenTable, ...]:
        from firmware_sim.physics.effects.registry import EFFECTS

        for i, item in enumerate(hidden):
            if item.name not in EFFECTS:
                raise ValueError(
                    f"entry {i + 1}: no effect named {item.name!r}; known are {', '.join(sorted(EFFECTS))}"
                )
        return hidden

    @property
    def takeoff_s(self) -> float:
        """Time of the recording at which free flight begins [s]."""
        return self.ground.before_s + self.ground.launch_s if self.ground.before_s > 0.0 else 0.0

    @property
    def total_s(self) -> float:
        """Length of the recording [s], ground phases included."""
        total = self.flight.duration_s
        if self.ground.before_s > 0.0:
            total += self.ground.before_s + self.ground.launch_s
        if self.ground.after_s > 0.0:
            total += self.ground.after_s + self.ground.landing_s
        return total

    def altered(self, **tables: Any) -> "Scenario":
        """A copy with some keys replaced, e.g. altered(flight={"seed": 4}, hidden=[{"name": "Cn_da"}]).

        Tables given as mappings are merged key by key; everything else is replaced. Checked like a file.
        """
        data = self.model_dump()
        for key, value in tables.items():
            if isinstance(value, Mapping) and isinstance(data.get(key), Mapping):
                data[key] = {**data[key], **value}
            else:
                data[key] = value
        return scenario_from(data, self.name)

    def toml(self) -> str:
        """The scenario as a TOML text that load_scenario reads back to the same scenario."""
        return toml_text(self.model_dump(exclude_defaults=True, mode="json"))


def scenario_from(data: Mapping[str, Any], where: str) -> Scenario:
    """A checked scenario; raises ScenarioError naming the key."""
    hints = {"manoeuvre.": f"; axes are {', '.join(AXES)}, shapes {', '.join(SHAPES)}"}
    return _at_flyable_speed(checked(Scenario, data, where, hints=hints), where)


def _at_flyable_speed(scenario: Scenario, where: str) -> Scenario:
    """The scenario, at the trim speed of its aircraft where it states none; ScenarioError for one it cannot fly at."""
    aircraft, flight = load_aircraft(scenario.flight.aircraft), scenario.flight
    simulation = simulation_of(aircraft)
    if "speed_m_s" not in flight.model_fields_set:
        return scenario.model_copy(update={"flight": flight.model_copy(update={"speed_m_s": simulation.speed})})
    slowest, fastest = simulation.speed_range
    if not slowest <= flight.speed_m_s <= fastest:
        raise ScenarioError(
            f"scenario {where}: flight.speed_m_s = {flight.speed_m_s:g} is outside the {slowest:g} to {fastest:g} m/s"
            f" that aircraft {aircraft.name} can be flown at; choose another"
        )
    return scenario


def built_in_scenarios() -> dict[str, str]:
    """Names of the built-in scenarios and their titles."""
    return {path.stem: load_scenario(path).title for path in sorted(BUILT_IN_FOLDER.glob("*.toml"))}


def load_scenario(name_or_path: str | Path) -> Scenario:
    """Read a built-in scenario by name, or a TOML file; `hidden_NAME` flies the rich plan with effect NAME hidden.

    Raises ScenarioError for an unknown name, an unreadable file, or naming the key that is wrong.
    """
    text = str(name_or_path)
    path = BUILT_IN_FOLDER / f"{text}.toml"
    if not path.is_file():
        if text.startswith("hidden_"):
            effect = text.removeprefix("hidden_")
            rich = load_scenario("rich").altered(
                title=f"rich manoeuvres with {effect} hidden",
                hidden=[{"name": effect}],
                wind={"gust_deg": 0.15},
                flight={"derivative_scatter": 0.15},
            )
            return rich.model_copy(update={"name": text})
        path = Path(text)
    if not path.is_file():
        built_in = sorted(p.stem for p in BUILT_IN_FOLDER.glob("*.toml"))
        suggestion = did_you_mean(text, built_in) or f" (built in: {', '.join(built_in)}, hidden_NAME)"
        raise ScenarioError(f"scenario {text!r}: no such file and no built-in of that name{suggestion}")
    data = read_toml(path, "file", ScenarioError)
    data.setdefault("name", path.stem)
    return scenario_from(data, str(path))
