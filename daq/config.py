"""The logger's configuration: one TOML file, checked before anything is opened.

Each part of the logger defines the model of its own section; this module puts the sections together, reads the file
and turns every mistake into one sentence that names the key.
"""

import hashlib
from collections.abc import Iterator
from pathlib import Path
from typing import Annotated, Any

from pydantic import BaseModel, ConfigDict, Field, ValidationError, model_validator

from daq.actuation.config import LEAST_RATE_HZ, SequencerConfig
from daq.companion.process import IdentificationConfig
from daq.identification.regression import DEFAULT_MODEL, REGRESSIONS
from daq.recorder.config import RecorderConfig
from daq.sensors.config import SensorsConfig
from daq.telemetry.config import DownlinkConfig
from daq.utilities.errors import UserError
from daq.utilities.input_files import parse_toml, read_text


class ConfigError(UserError):
    """A configuration file that cannot be used."""


class ConfigSection(BaseModel):
    """Base of all configuration sections: unknown keys are mistakes, values do not change after reading."""

    model_config = ConfigDict(extra="forbid", frozen=True, allow_inf_nan=False)


_FINISHING_NS = 1_000_000  # to finish one scan on a slow computer
_ROOM_TO_FINISH = 0.1  # of the time between two scans


class AircraftConfig(ConfigSection):
    """`[aircraft]`: which aircraft carries the logger."""

    name: str = Field(default="", description="name under which results are filed; empty: flights name no aircraft")
    tail_number: str = Field(default="", description="the individual aircraft")
    file: str = Field(default="", description="its file (docs/aircraft.md), carried by every recording; empty: none")


class ScanConfig(ConfigSection):
    """`[scan]`: how often all channels are read, and how the process is scheduled."""

    rate_hz: Annotated[float, Field(gt=0, le=2000)] = 20.0
    realtime_priority: Annotated[int, Field(ge=0, le=99)] = 0  # SCHED_FIFO priority; 0 keeps the ordinary scheduler
    lock_memory: bool = False  # mlockall: pages of the process are never swapped out
    garbage_in_slack: bool = True  # collect garbage after scans only, instead of whenever Python would
    hand_over_s: Annotated[float, Field(ge=0, le=1)] = 0.1  # scans go to recorder and radio this often; 0: each at once

    @property
    def period_ns(self) -> int:
        """Time from one scan to the next [ns]."""
        return round(1e9 / self.rate_hz)

    @property
    def together(self) -> int:
        """How many scans are finished and handed over at a time: as `hand_over_s` says, and no more than a scan has room for."""
        requested = round(self.hand_over_s * self.rate_hz)
        room = _ROOM_TO_FINISH * self.period_ns // _FINISHING_NS
        return max(1, int(min(requested, room)))


class PreflightConfig(ConfigSection):
    """`[preflight]`: the limits of the go/no-go table."""

    scans: Annotated[int, Field(ge=2, le=10_000)] = 80  # scans looked at; should outlast the stuck-value times
    free_space_mb: Annotated[float, Field(ge=0)] = 200.0
    write_latency_ms: Annotated[float, Field(gt=0)] = 500.0  # slowest write + fdatasync tolerated
    lateness_p99_ms: Annotated[float, Field(gt=0)] = 5.0
    time_accuracy_ms: Annotated[float, Field(gt=0)] = (
        30.0  # of UTC from GPS; without a pulse per second some 18 ms are known
    )
    radio_margin_db: Annotated[float, Field(ge=0)] = 10.0  # signal above noise, where the radio reports it
    require_time: bool = True  # False: no UTC from GPS is a caution, not a no-go
    require_radio: bool = False
    auto_zero: bool = (
        True  # a pitot that rests beyond 10 Pa is zeroed on the ground before motion, and the recording says so
    )


class LoggerConfig(ConfigSection):
    """The whole file. `calibration` is a directory of calibration files, embedded in every recording."""

    aircraft: AircraftConfig = AircraftConfig()
    scan: ScanConfig = ScanConfig()
    recorder: RecorderConfig = RecorderConfig()
    sensors: SensorsConfig
    downlink: DownlinkConfig | None = None
    sequencer: SequencerConfig | None = None
    identification: IdentificationConfig | None = None
    preflight: PreflightConfig = PreflightConfig()
    calibration: Path | None = None

    @model_validator(mode="after")
    def _queue_holds_a_stall(self) -> "LoggerConfig":
        if self.recorder.queue_s < self.recorder.flush_s:
            raise ValueError("recorder.queue_s must not be shorter than recorder.flush_s")
        return self

    @model_validator(mode="after")
    def _sequencer_is_served(self) -> "LoggerConfig":
        if self.sequencer is not None:
            if self.sequencer.wanted is not None:
                self._check_wanted(self.sequencer.wanted.name)
            check_sequencer(self.sequencer, self.sensors, self.scan.rate_hz)
        return self

    def _check_wanted(self, name: str) -> None:
        """Whether `sequencer.until` names what is identified on board; what the file of a model estimates the companion knows."""
        if self.identification is None:
            raise ValueError("sequencer.until goes by identification on board; add a section [identification]")
        model = self.identification.model or DEFAULT_MODEL
        estimated = [n for r in REGRESSIONS.get(model, ()) for n in r.shown]
        if estimated and name not in estimated:
            raise ValueError(
                f"sequencer.until: model {model} does not estimate {name}; name one of {', '.join(estimated)}"
            )

    @model_validator(mode="after")
    def _one_user_a_port(self) -> "LoggerConfig":
        user_of: dict[str, str] = {}
        for user, device in self._serial_ports():
            if device in user_of:
                raise ValueError(f"{user_of[device]} and {user} share the serial port {device}")
            user_of[device] = user
        return self

    def _serial_ports(self) -> Iterator[tuple[str, str]]:
        """Who opens which serial port."""
        sensors = self.sensors
        if sensors.gnss is not None and "gnss" not in sensors.from_sender:
            yield "sensors.gnss", sensors.gnss.device
        if sensors.autopilot_port is not None:
            yield "sensors.autopilot" if sensors.autopilot else "sensors.capture", sensors.autopilot_port[0]
        if self.downlink is not None and self.downlink.port.startswith("serial:"):
            yield "downlink", self.downlink.port.split(":")[1]

    @model_validator(mode="after")
    def _identification_has_what_it_needs(self) -> "LoggerConfig":
        if self.identification is not None:
            if self.calibration is None:
                raise ValueError("identification needs calibrated scans; set the key calibration")
            if not (self.aircraft.name or self.aircraft.file):
                raise ValueError("identification needs the aircraft; set aircraft.name or aircraft.file")
        return self

    @property
    def together(self) -> int:
        """How many scans are finished together: one by one where a sequencer goes by them."""
        return 1 if self.sequencer is not None else self.scan.together


def check_sequencer(sequencer: SequencerConfig, sensors: SensorsConfig, rate_hz: float) -> None:
    """Raise ValueError unless scans are frequent enough and show what the sequencer watches, at addresses of their own."""
    if rate_hz < LEAST_RATE_HZ:
        raise ValueError(f"sequencer goes by the scan; set scan.rate_hz to at least {LEAST_RATE_HZ:g}, not {rate_hz:g}")
    limits = sequencer.limits
    watched = {
        "attitude": limits.bank_deg,
        "imu": limits.load_factor,
        "pitot": limits.airspeed,
        "analog_a": limits.alpha_deg,
        "gnss": limits.height_m,
        "capture": any(o.readback for o in sequencer.output.values()) or None,
    }
    missing = [group for group, limit in watched.items() if limit is not None and group not in sensors.fitted]
    if missing:
        raise ValueError(f"sequencer watches {', '.join(missing)}, not fitted; fit it or set its limit aside")
    if sequencer.through != "pca9685":
        port = sensors.autopilot_port
        if port is not None and port[0] in sequencer.autopilot.port:
            raise ValueError(
                f"sequencer.autopilot and the sensors both read {port[0]}; give the sequencer a port of its own"
            )
        return
    addresses = {getattr(sensors.section(g), "address", None): g for g in sensors.fitted}
    for name, address in (("chip", sequencer.chip.address), ("pilot", sequencer.pilot.address)):
        if address in addresses or sequencer.chip.address == sequencer.pilot.address:
            owner = addresses.get(address, "the other chip of the sequencer")
            raise ValueError(f"sequencer.{name} and {owner} share the I2C address 0x{address:02x}")


def load_config(path: str | Path) -> tuple[LoggerConfig, str]:
    """Read and check a configuration; returns it and the text of the file, which every recording carries.

    Relative paths in the file are taken from the file's directory. Raises ConfigError naming file, key, value
    and limit.
    """
    path = Path(path)
    text = read_text(path, "configuration file", ConfigError)
    return parse_config(text, path), text


def parse_config(text: str, origin: Path) -> LoggerConfig:
    """Check the text of a configuration; `origin` names it in errors and anchors relative paths."""
    table = parse_toml(text, str(origin), ConfigError)
    try:
        config = LoggerConfig.model_validate(table)
    except ValidationError as error:
        raise ConfigError(f"{origin}: {describe(error)}") from error
    return _anchor(config, origin.parent)


def describe(error: ValidationError) -> str:
    """A validation error as one sentence: each wrong key with its value and what it must be."""
    return "; ".join(_sentence_of(e) for e in error.errors(include_url=False)[:5])


def _sentence_of(error: Any) -> str:
    key = ".".join(str(p) for p in error["loc"]) or "the file as a whole"
    if error["type"] == "extra_forbidden":
        return f"key {key} is not known; check its spelling or remove it"
    if error["type"] == "missing":
        return f"key {key} is missing"
    value = error["input"]
    value_text = f" is {value!r}" if isinstance(value, (str, int, float, bool)) else ""
    return f"key {key}{value_text}: {error['msg'][0].lower()}{error['msg'][1:]}"


def _anchor(config: LoggerConfig, base: Path) -> LoggerConfig:
    directories = tuple(base / d for d in config.recorder.directories)
    changes: dict[str, Any] = {"recorder": config.recorder.model_copy(update={"directories": directories})}
    if config.calibration is not None:
        changes["calibration"] = base / config.calibration
    if config.aircraft.file:
        changes["aircraft"] = config.aircraft.model_copy(update={"file": str(base / config.aircraft.file)})
    if config.sequencer is not None:
        manoeuvre = base / config.sequencer.manoeuvre
        changes["sequencer"] = config.sequencer.model_copy(update={"manoeuvre": manoeuvre})
    return config.model_copy(update=changes)


def read_aircraft(file: str) -> bytes | None:
    """The aircraft's file; None where none is named. Raises ConfigError when it cannot be read."""
    if not file:
        return None
    try:
        return Path(file).read_bytes()
    except OSError as error:
        raise ConfigError(
            f"{file}: the aircraft's file cannot be read ({error.strerror}); correct the key aircraft.file"
        ) from error


def read_calibration(directory: Path | None) -> dict[str, bytes]:
    """The calibration files of a directory by name relative to it; empty without a directory.

    Raises ConfigError when the directory is named but absent or holds no .toml file.
    """
    if directory is None:
        return {}
    if not directory.is_dir():
        raise ConfigError(f"{directory}: calibration directory not found; correct the key calibration")
    files = {str(p.relative_to(directory)): p.read_bytes() for p in sorted(directory.rglob("*.toml"))}
    if not files:
        raise ConfigError(f"{directory}: no calibration files (*.toml) in it; correct the key calibration")
    return files


def digest(data: bytes) -> str:
    """SHA-256 of a file's bytes, as recordings and reports quote it."""
    return hashlib.sha256(data).hexdigest()
