"""Configuration of the ground station: one TOML file, checked; errors name the key."""

from collections.abc import Iterable
from pathlib import Path
from typing import Annotated, Any, Literal

from pydantic import BaseModel, ConfigDict, Field, ValidationError

from daq.identification.regression import REGRESSIONS
from daq.utilities.errors import UserError
from daq.utilities.input_files import read_toml
from groundstation.live.watches import FREE_MB, MINUTES_LEFT, LandingLimits, Limit
from groundstation.receiver.ports import LinkConfig


class GroundConfigError(UserError):
    """A configuration file of the ground station that cannot be used."""


class _GroundTable(BaseModel):
    model_config = ConfigDict(extra="forbid", frozen=True, allow_inf_nan=False)


class SessionOutputConfig(_GroundTable):
    """Where a session goes: `directory`/<UTC time of start>, or exactly `directory` when `dated` is false."""

    directory: Path = Path("flights")
    dated: bool = True


class CalibrationConfig(_GroundTable):
    """`directory`: calibration files, or the name of a built-in set, used live until the aircraft's own have arrived."""

    directory: str = "cdfp"


class ViewConfig(_GroundTable):
    """The live view. port: for further viewers of this computer. host: address on which the page listens; beyond loopback, and
    with `token`, the page opens only by its complete address, which holds a token."""

    layout: Literal["full", "light", "phone"] = "full"
    port: Annotated[int, Field(ge=1, le=65535)] = 9876
    web_port: Annotated[int, Field(ge=1, le=65535)] = 9090
    host: Annotated[str, Field(min_length=1, max_length=255)] = "127.0.0.1"
    token: bool = False
    memory_limit: str = "64MiB"


class HandoverConfig(_GroundTable):
    """End of a flight. onboard: directory where the aircraft's own recording appears (card reader, Wi-Fi): preferred to
    telemetry when it is there. backfill_limit_s: how long missing scans are fetched after landing."""

    landing: LandingLimits = LandingLimits()
    backfill_limit_s: Annotated[float, Field(ge=0.0)] = 1800.0
    onboard: Path | None = None
    model: str = "lateral"
    methods: str = "ml"


class LiveIdentificationConfig(_GroundTable):
    """Live identification. watch: whether the gap monitor runs too. aircraft: name or file; empty: the one that the recording
    names or carries. model: lateral (the default), longitudinal, six-dof, or the file of a model, which the gap monitor then
    compares with the flight instead of the beliefs of the aircraft file. wanted: bound to be reached, one standard deviation, as
    a share of a derivative. forward: ports that get NAMED_VALUE_FLOAT of each derivative. lines_every_s: time of flight between
    two lines in the log."""

    enabled: bool = True
    watch: bool = False
    aircraft: str = ""
    model: str = ""
    wanted: Annotated[float, Field(gt=0.0, lt=1.0)] = 0.05
    forward: tuple[str, ...] = ()
    lines_every_s: Annotated[float, Field(gt=0.0)] = 30.0


DEFAULT_ALARMS = (
    Limit(channel="V", low=10.0, high=27.0, hysteresis=0.5, hold_s=0.5, level="ERROR", text="airspeed"),
    Limit(channel="alpha", high=0.26, hysteresis=0.02, hold_s=0.3, level="ERROR", text="angle of attack"),
    Limit(channel="supply_voltage", low=10.5, hysteresis=0.2, hold_s=2.0, level="ERROR", text="supply voltage"),
    Limit(channel="link.loss_percent", high=30.0, hysteresis=10.0, hold_s=3.0, level="WARN", text="link loss"),
    Limit(channel="link.silence_s", high=3.0, level="CRITICAL", text="no telemetry"),
    Limit(channel="recorder.recording", low=0.5, hold_s=2.0, level="CRITICAL", text="onboard recorder stopped"),
    Limit(channel=FREE_MB, low=200.0, hysteresis=50.0, level="ERROR", text="disk of the ground station nearly full"),
    Limit(channel=MINUTES_LEFT, low=30.0, hysteresis=10.0, hold_s=5.0, text="disk of the ground station, minutes left"),
    Limit(channel="sensors.unusable", high=0.5, hold_s=1.0, level="WARN", text="sensor not usable"),
)


class GroundConfig(_GroundTable):
    """The configuration file. Alarm channels are flight columns, or `link.loss_percent`, `link.silence_s`, `recorder.recording`,
    `ground.free_mb`, `ground.minutes_left` (of this computer's disk), `sensors.unusable` (number of sensor groups);
    airspeed and angle of attack count in flight only.
    """

    link: LinkConfig = LinkConfig()
    output: SessionOutputConfig = SessionOutputConfig()
    calibration: CalibrationConfig = CalibrationConfig()
    view: ViewConfig = ViewConfig()
    handover: HandoverConfig = HandoverConfig()
    identification: LiveIdentificationConfig = LiveIdentificationConfig()
    alarms: tuple[Limit, ...] = DEFAULT_ALARMS


def load_ground_config(path: Path) -> GroundConfig:
    """Read a configuration. Raises GroundConfigError naming file and key."""
    table = read_toml(path, "configuration file", GroundConfigError)
    try:
        return GroundConfig.model_validate(table)
    except ValidationError as error:
        first = error.errors()[0]
        key = ".".join(str(part) for part in first["loc"])
        further = f" (and {error.error_count() - 1} more)" if error.error_count() > 1 else ""
        raise GroundConfigError(f"{path}: key {key}: {first['msg']}{further}; correct it or leave it out") from error


def configured(
    path: Path | None,
    layout: str | None = None,
    aircraft: str | None = None,
    watch: bool = False,
    model: Path | None = None,
) -> GroundConfig:
    """The configuration of a file; without a file the defaults, on the usual ports. layout, aircraft, model: replace the
    configured ones. watch: switches the gap monitor on, as a model file does.

    Raises GroundConfigError naming file and key, or the model where there is no such file.
    """
    if path is None:
        config = GroundConfig(link=LinkConfig(ports=usual_ports()))
    else:
        config = load_ground_config(path)
    changes: dict[str, object] = {} if aircraft is None else {"aircraft": aircraft}
    changes |= {"watch": True} if watch or (model is not None and str(model) not in REGRESSIONS) else {}
    changes |= {} if model is None else {"model": str(model)}
    config = config.model_copy(update={"identification": config.identification.model_copy(update=changes)})
    chosen_model = config.identification.model
    if chosen_model in REGRESSIONS:
        handover = config.handover if model is None else config.handover.model_copy(update={"model": chosen_model})
        config = config.model_copy(update={"handover": handover})
    elif chosen_model and not Path(chosen_model).is_file():
        raise GroundConfigError(
            f"{chosen_model}: no such file; the model that the gap monitor is to hold against flight must be one"
        )
    if layout is None:
        return config
    view = ViewConfig.model_validate({**config.view.model_dump(), "layout": layout})
    return config.model_copy(update={"view": view})


LISTENER = "udpin:14550"  # MAVLink's port of ground stations; on loopback, where no other computer can send
BAUD = 57600  # SiK radios as delivered

RADIOS = frozenset({(0x0403, 0x6015), (0x0403, 0x6001), (0x10C4, 0xEA60)})
"""USB vendor and product of the serial chips on telemetry radios: FT230X and FT232R of FTDI (3DR, Holybro, mRo), CP2102 of
Silicon Labs (RFD900, its clones). Other serial devices are not opened: opening one can reset the board behind it."""


def usual_ports(devices: Iterable[Any] | None = None) -> tuple[str, ...]:
    """The UDP port, then every telemetry radio on USB, in the form of `[link] ports`. devices: serial devices as
    `serial.tools.list_ports` lists them (vid and pid are None without USB); those of this computer by default."""
    if devices is None:
        from serial.tools.list_ports import comports

        devices = comports()
    radios = sorted(d.device for d in devices if (d.vid, d.pid) in RADIOS)
    return (LISTENER, *(f"serial:{device}:{BAUD}" for device in radios))
