"""Put a logger together from its configuration and the things at its edge, real or simulated.

The same function builds the logger on the aircraft and in the simulator; only the objects handed to it differ.
"""

import secrets
from collections.abc import Callable, Iterable
from dataclasses import dataclass, replace

from daq.acquisition.air_truth import AirTruth
from daq.acquisition.sampler import Sampler
from daq.actuation.actuation import Actuation, AutopilotPort, Devices, output_of
from daq.actuation.pwm.heartbeat import HeartbeatLine
from daq.actuation.servos import plan_of
from daq.clock import Clock
from daq.companion.process import Companion, IdentificationConfig
from daq.config import LoggerConfig, read_aircraft, read_calibration
from daq.contract.channels import CHANNELS
from daq.contract.manoeuvre import load_manoeuvre
from daq.contract.recordings.messages import LogLevel
from daq.contract.recordings.recording import (
    AIRCRAFT_ATTACHMENT,
    CALIBRATION_PREFIX,
    CONFIG_ATTACHMENT,
    MANOEUVRE_ATTACHMENT,
    RecordingInfo,
    software_version,
)
from daq.logger import Logger, Opening
from daq.recorder.counts import LoopTiming
from daq.recorder.recorder import Recorder
from daq.recorder.storage import Storage
from daq.sensors.bus import I2cBus, SerialPortCalls
from daq.telemetry.link import RadioLink, radio_link
from daq.telemetry.uplink import TURN_NS
from daq.transport.ports import BytePort
from daq.utilities.utc_stamps import name_stamp

_INFORMATIONAL = 6  # severity of STATUSTEXT, as syslog has it
_UPLINK_SHARE = 0.1
"""What arrives may take this share of the time between two turns of the link, however high the scan rate."""


@dataclass(frozen=True, slots=True)
class HardwareEdge:
    """What the logger is connected to.

    bus, gnss, autopilot, pulse: as `daq.acquisition.sampler.Sampler` takes them. radio: the port to the ground, None without one.
    source: real | simulated; every recording says it for good. heartbeat: the line that enables the servo driver. override: the
    port to an autopilot that the sequencer goes through.
    """

    clock: Clock
    bus: I2cBus | None
    gnss: SerialPortCalls | None
    source: str
    autopilot: SerialPortCalls | None = None
    pulse: Callable[[], int | None] | None = None
    radio: BytePort | None = None
    storage: Storage | None = None
    heartbeat: HeartbeatLine | None = None
    override: AutopilotPort | None = None


@dataclass(frozen=True)
class Assembly:
    """A logger ready to run, and its parts."""

    logger: Logger
    sampler: Sampler
    recorder: Recorder
    link: RadioLink | None
    session: str
    actuation: Actuation | None = None


def session_name(config: LoggerConfig, clock: Clock, *, unique: bool = True) -> str:
    """Name of a session: aircraft, time as the clock believes it, and something to tell equal times apart.

    A companion computer without a battery may start several flights at the same wrong time.
    """
    stamp = name_stamp(clock.utc_ns() // 10**9)
    return f"{config.aircraft.name or 'flight'}_{stamp}" + (f"_{secrets.token_hex(2)}" if unique else "")


def recording_info(config: LoggerConfig, text: str, session: str, source: str, started_utc_ns: int) -> RecordingInfo:
    """Identity of a session, with the configuration and the calibration files to be embedded."""
    attachments = {CONFIG_ATTACHMENT: text.encode()}
    calibration = read_calibration(config.calibration)
    if calibration and any(
        c.package for c in CHANNELS
    ):  # files of laboratory packages; the directory's own go before them
        from daq.contract.laboratory import calibration_files

        calibration = {**calibration_files(), **calibration}
    attachments |= {CALIBRATION_PREFIX + k: v for k, v in calibration.items()}
    aircraft = read_aircraft(config.aircraft.file)
    if aircraft is not None:
        attachments[AIRCRAFT_ATTACHMENT] = aircraft
    if config.sequencer is not None:
        attachments[MANOEUVRE_ATTACHMENT] = config.sequencer.manoeuvre.read_bytes()
    return RecordingInfo(
        session=session,
        source=source,
        aircraft=config.aircraft.name,
        scan_rate_hz=config.scan.rate_hz,
        started_utc_ns=max(0, started_utc_ns),
        software=software_version(),
        details={"tail_number": config.aircraft.tail_number} if config.aircraft.tail_number else {},
        attachments=attachments,
    )


def assemble(
    config: LoggerConfig,
    text: str,
    edge: HardwareEdge,
    *,
    session: str | None = None,
    folder: str | None = None,
    boot: int | None = None,
    opening: Iterable[Opening] = (),
    housekeeping: Callable[[], None] = lambda: None,
) -> Assembly:
    """Build the logger.

    text: the configuration as written, embedded in recordings. session: name of the first recording; `folder`: directory
    under the configured ones that takes it, by default one named like the session. boot: see `Downlink`.
    """
    timing = LoopTiming()
    first = session or session_name(config, edge.clock)
    actuation = _actuation(config, edge)
    # Made once: a recording begun by command must not wait for the card that holds the calibration files.
    identity = recording_info(config, text, first, edge.source, edge.clock.utc_ns())

    def make_recorder(name: str, place: str) -> Recorder:
        info = replace(identity, session=name, started_utc_ns=max(0, edge.clock.utc_ns()))
        return Recorder(config.recorder, info, edge.clock, folder=place, storage=edge.storage, timing=timing)

    def next_recorder() -> Recorder:
        name = session_name(config, edge.clock)
        return make_recorder(name, name if folder is None else folder)

    sampler = Sampler(
        config.sensors,
        edge.bus,
        edge.gnss,
        edge.clock,
        rate_hz=config.scan.rate_hz,
        autopilot=edge.autopilot,
        pulse=edge.pulse,
    )
    recorder = make_recorder(first, first if folder is None else folder)
    logger = Logger(
        config.scan.rate_hz,
        edge.clock,
        sampler,
        recorder,
        together=config.together,
        timing=timing,
        new_recorder=next_recorder,
        housekeeping=housekeeping,
        opening=opening,
    )
    logger.check_air_truth(AirTruth(config.sensors, auto_zero=config.preflight.auto_zero))
    if actuation is not None:
        logger.attach_actuation(actuation)
    link = _radio_link(config, edge, identity, sampler, boot)
    if link is not None:
        link.report_on(logger)
        logger.connect(link, link.uplink)
        if actuation is not None:
            actuation.link_s = link.uplink.silence_s
    if config.identification is not None:
        companion = _companion(config, config.identification, logger, link)
        logger.attach_companion(companion)
        if actuation is not None:
            actuation.known = companion.known
    return Assembly(logger, sampler, recorder, link, first, actuation)


def _radio_link(
    config: LoggerConfig, edge: HardwareEdge, identity: RecordingInfo, sampler: Sampler, boot: int | None
) -> RadioLink | None:
    """The link to the ground; None without a downlink or a radio. identity: sent as the papers, with the sensors' metadata."""
    if config.downlink is None or edge.radio is None:
        return None
    return radio_link(
        config.downlink,
        edge.radio,
        edge.clock,
        papers=lambda: replace(identity, details={**identity.details, **sampler.metadata()}),
        recordings=config.recorder.directories,
        boot=boot,
        turn_ns=min(TURN_NS, round(_UPLINK_SHARE * config.together * config.scan.period_ns)),
        facts=sampler.metadata,
    )


def _companion(config: LoggerConfig, wanted: IdentificationConfig, logger: Logger, link: RadioLink | None) -> Companion:
    """The process that identifies on board; its numbers go into the recording and down the link."""
    show = (lambda name, value: None) if link is None else link.downlink.messages.set_named
    aircraft = config.aircraft.file or config.aircraft.name
    flown_for = config.sequencer.wanted if config.sequencer is not None else None
    until = "" if flown_for is None else flown_for.name

    def tell(text: str) -> None:
        logger.say(LogLevel.INFO, "test point", text)  # lines named identification are JSON
        if link is not None:
            link.text(_INFORMATIONAL, text)

    return Companion(wanted, aircraft, str(config.calibration), logger.say, show, tell, until)


def _actuation(config: LoggerConfig, edge: HardwareEdge) -> Actuation | None:
    """The sequencer with its manoeuvre checked; None where none is configured. Raises ManoeuvreError,
    HeartbeatError or AutopilotError."""
    if config.sequencer is None:
        return None
    output = output_of(config.sequencer, Devices(edge.bus, edge.heartbeat, edge.clock, edge.override))
    plan = plan_of(load_manoeuvre(config.sequencer.manoeuvre), config.sequencer)
    return Actuation(config.sequencer, plan, config.sensors, output, edge.clock, 1.0 / config.scan.rate_hz)
