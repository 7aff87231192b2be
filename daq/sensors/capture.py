"""Capture co-processor: six servo pulse widths and five digital inputs, over I2C.

The register map, version 1, is specified in docs/sensors.md. Widths are 0.1 us counts of the last complete pulse.
Self-test: identity and map version; snapshot with a good checksum. Plausibility: a wrong checksum is a failed
transfer; a sequence that stands still is stale; a wired PWM input without valid pulses is out of range.
A channel without a valid pulse is left unset; a digital bit is 1 if the input was high at any time since the last scan.
"""

import errno
from collections.abc import Callable, Generator
from struct import Struct
from typing import Annotated

import fastcrc
from pydantic import Field, model_validator

from daq.contract.scan import RawValue, SensorState
from daq.sensors.base import MS, Address, Driver, Reading, SelfTestError, SensorSection, Wait, WrongChipError

ID, MAP_VERSION, FIRMWARE, CONTROL, TIMEOUT, SNAPSHOT = 0x00, 0x01, 0x02, 0x04, 0x05, 0x10
IDENTITY, VERSION, ACKNOWLEDGE = 0x5C, 1, 0x01
SNAPSHOT_LENGTH = 28
STATUS_RESET, STATUS_OVERRUN = 0x01, 0x02
NO_EDGE = 0xFFFF

_SNAPSHOT = Struct("<H6HB6s3BHBB")
_PWM = tuple((1 << i, f"pwm_{i + 1}") for i in range(6))
_DIGITAL = tuple((1 << i, f"digital_{i + 1}") for i in range(5))
_SLICE = 4 * MS  # the loop counts milliseconds; standing still for longer is a dead loop


crc8: Callable[[bytes], int] = fastcrc.crc8.smbus
"""CRC-8/SMBUS: polynomial 0x07, start 0."""


class CaptureConfig(SensorSection):
    """`[sensors.capture]`: PWM widths and digital inputs.

    driver `capture` is the co-processor on I2C; `mavlink_servo` listens to an autopilot's SERVO_OUTPUT_RAW on the
    serial `device` instead (no digital inputs then), `sbus` to a receiver's SBUS behind an
    inverter; `gpio` times the pulses at `lines` of the GPIO `chip`, in the order of the
    outputs. pwm_inputs: how many of the six are wired and must be alive.
    """

    driver: str = "capture"
    address: Address = 0x40
    timeout_ms: Annotated[int, Field(ge=10, le=250)] = 50
    debounce_ms: Annotated[int, Field(ge=0, le=250)] = 10
    pwm_inputs: Annotated[int, Field(ge=0, le=6)] = 4
    device: str = "/dev/ttyACM0"
    chip: str = "/dev/gpiochip0"
    lines: Annotated[tuple[Annotated[int, Field(ge=0)], ...], Field(max_length=6)] = ()
    baud: Annotated[int, Field(ge=1200)] = 115200

    @model_validator(mode="after")
    def _lines_for_pulses(self) -> "CaptureConfig":
        if (self.driver == "gpio") != bool(self.lines) or len(set(self.lines)) != len(self.lines):
            raise ValueError(
                "lines: numbers of the GPIO lines of pwm_1 and so on, each once, with driver = 'gpio' only"
            )
        return self


class ChecksumError(OSError):
    """A snapshot whose checksum is wrong: the transfer was disturbed."""

    def __init__(self) -> None:
        super().__init__(errno.EBADMSG, "capture co-processor: checksum of the snapshot is wrong")


class Capture(Driver):
    """Pulse widths [0.1 us] and digital bits; reports edges of the event switch."""

    name, groups, precedence = "capture", ("capture",), 3
    _config: CaptureConfig

    def _derive_settings(self) -> None:
        self._wired = (1 << self._config.pwm_inputs) - 1
        self._sequence: int | None = None
        self._sequence_ns = 0
        self._edges: int | None = None
        self._firmware = ""

    def initialise(self) -> Generator[Wait, None, None]:
        bus, address = self._bus, self._address
        identity, version, minor, major = bus.read_i2c_block_data(address, ID, 4)
        if identity != IDENTITY:
            raise WrongChipError("capture co-processor", address, IDENTITY, identity)
        if version != VERSION:
            raise SelfTestError(
                f"capture co-processor speaks register map {version}, this driver {VERSION}; update its firmware"
            )
        self._firmware = f"{major}.{minor}"
        bus.write_i2c_block_data(address, TIMEOUT, [self._config.timeout_ms, self._config.debounce_ms])
        bus.write_byte_data(address, CONTROL, ACKNOWLEDGE)
        self._sequence = self._edges = None
        yield 25 * MS  # one servo frame, so that widths are there
        self._snapshot()

    def _snapshot(self) -> tuple[int, ...]:
        data = bytes(self._bus.read_i2c_block_data(self._address, SNAPSHOT, SNAPSHOT_LENGTH))
        if crc8(data[:-1]) != data[-1]:
            raise ChecksumError
        fields: tuple[int, ...] = _SNAPSHOT.unpack(data)
        return fields

    def read(self) -> Reading:
        sequence, *rest = self._snapshot()
        widths, valid = rest[0:6], rest[6]
        _level, latched, edges, edge_age, status, _crc = rest[8:14]
        now_ns = self._now()
        if status & STATUS_RESET:
            return Reading(state=SensorState.FAULT, detail="capture co-processor was restarted")
        if sequence != self._sequence:
            self._sequence, self._sequence_ns = sequence, now_ns
        elif now_ns - self._sequence_ns > _SLICE:
            return Reading(state=SensorState.STALE, detail="capture co-processor's loop stands still")
        values: dict[str, RawValue] = {}
        for (bit, name), width in zip(_PWM, widths, strict=True):
            if valid & bit:
                values[name] = width
        for bit, name in _DIGITAL:
            values[name] = 1 if latched & bit else 0
        events = self._new_edges(edges, edge_age, now_ns) if edges != self._edges else ()
        if self._wired & ~valid:
            silent = [name for bit, name in _PWM if self._wired & ~valid & bit]
            return Reading(values, SensorState.OUT_OF_RANGE, f"no valid pulses on {', '.join(silent)}", now_ns, events)
        if status & STATUS_OVERRUN:
            return Reading(values, SensorState.OUT_OF_RANGE, "capture co-processor lost edges", now_ns, events)
        return Reading(values, time_ns=now_ns, events=events)

    def intact(self) -> bool:
        settings = self._bus.read_i2c_block_data(self._address, TIMEOUT, 2)
        return list(settings) == [self._config.timeout_ms, self._config.debounce_ms]

    def _new_edges(self, edges: int, age_ms: int, now: int) -> tuple[int, ...]:
        """Times of switch edges since the last reading; only the newest one's is known, earlier ones share it."""
        last, self._edges = self._edges, edges
        if last is None:
            return ()
        time_ns = now if age_ms == NO_EDGE else now - age_ms * MS
        return (time_ns,) * ((edges - last) & 0xFF)

    def metadata(self) -> dict[str, str]:
        return {"chip": "capture co-processor", "firmware": self._firmware, "scale_s": "1e-07"}
