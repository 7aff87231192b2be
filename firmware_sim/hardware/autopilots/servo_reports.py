"""An ArduPlane on a serial line that streams its measurements and outputs, for aircraft without sensors of their own.

It sends HEARTBEAT once a second, SERVO_OUTPUT_RAW at its stream rate, in whole microseconds, and the messages that
SET_MESSAGE_INTERVAL requests. After ArduPlane 4.5 (GCS_Common.cpp): intervals are whole milliseconds; messages leave in the
loops of SCHED_LOOP_RATE, in turn, stamped by its clock since start-up; 0.8 of an interval must not be shorter than a loop. The
pitot is read ten times a second, and IMU samples pass a low pass of second order. Bytes leave at the speed of the line.
"""

import math
from collections.abc import Callable

import numpy as np

from daq.utilities.constants import GRAVITY, ZERO_CELSIUS
from firmware_sim.hardware.autopilots.frames import (
    ATTITUDE,
    COMMAND_ACK,
    COMMAND_LONG,
    GLOBAL_POSITION_INT,
    GPS_RAW_INT,
    HEARTBEAT,
    HIGHRES_IMU,
    PARAM_REQUEST_READ,
    PARAM_VALUE,
    RAW_IMU,
    SCALED_PRESSURE,
    SERVO_OUTPUT_RAW,
    STATUSTEXT,
    SYSTEM_TIME,
    TIMESYNC,
    Message,
    Packer,
    Unpacker,
    text_of,
)
from firmware_sim.hardware.autopilots.looped import LossyLine
from firmware_sim.hardware.sensing.instruments import Instruments

STREAM_NS = 50_000_000  # of SERVO_OUTPUT_RAW unless another interval is requested
MS = 1_000_000
SET_MESSAGE_INTERVAL, ACCEPTED, DENIED, UNSUPPORTED = 511, 0, 2, 3
FILTER_HZ = 20.0  # INS_GYRO_FILTER and INS_ACCEL_FILTER
FILTER_DELAY_NS = round(math.sqrt(2.0) / (2.0 * math.pi * FILTER_HZ) * 1e9)  # of a Butterworth low pass of second order
PITOT_NS = 100 * MS
BOOTED_NS = 93_214_000_000
"""Its clock at the start of the recording: time since it was switched on."""
CLOCK_PPM = 17.0  # rate error of its clock
BUFFER_NS = 40 * MS
"""A stream's message is dropped while the line is behind by more (HAVE_PAYLOAD_SPACE)."""
UTC_AFTER_NS = 4_000 * MS  # until the first GPS fix
LEVEL_ERROR_RAD, GAUSS = 0.004, 1e-4  # standard deviation of the attitude's constant error; tesla
STREAMS: tuple[Message, ...] = (
    *(HIGHRES_IMU, RAW_IMU, ATTITUDE, SCALED_PRESSURE, GLOBAL_POSITION_INT, GPS_RAW_INT, SYSTEM_TIME, SERVO_OUTPUT_RAW),
)


class Autopilot:
    """A `Talker` for the drivers `mavlink_servo` and `autopilot`.

    loop_hz: SCHED_LOOP_RATE. without: numbers of messages that it does not support. start_utc_ns: UTC at the instruments' origin
    [ns].
    """

    loop_hz = 50.0
    without: frozenset[int] = frozenset()
    start_utc_ns = 0

    def __init__(self, instruments: Instruments) -> None:
        self._at, self._models = instruments.inputs, instruments.models
        self._inputs = instruments.inputs(*(f"pwm_{i}" for i in range(1, 7)))
        self._rng = instruments.generator("autopilot")
        self._origin_ns = self._next_ns = self._loop_ns = instruments.origin_ns
        self._level = LEVEL_ERROR_RAD * self._rng.standard_normal(3)
        self._pitot: tuple[int, float] = (0, 0.0)  # time of the next reading [ns], last pressure [Pa]
        self._streams: dict[int, tuple[int, int]] = {}  # message number -> interval and next time [ns]
        self._packer, self._unpacker, self._line, self._inward = Packer(), Unpacker(), LossyLine(), LossyLine()
        self._powered = True

    def connect(self, baud: int, loop_hz: float) -> None:
        """Set SERIALn_BAUD and SCHED_LOOP_RATE, before the first byte."""
        self.loop_hz = loop_hz
        self._line, self._inward = LossyLine(baud), LossyLine(baud)

    def set_power(self, on: bool, now_ns: int) -> None:
        """Switch the power on or off; requested intervals are lost."""
        self._powered = on
        self._streams.clear()

    def receive(self, data: bytes, now_ns: int) -> None:
        """Take bytes, which arrive at the speed of the line."""
        self._inward.send(data, now_ns)

    def bytes_until(self, now_ns: int) -> bytes:
        while min(self._next_ns, self._loop_ns) <= now_ns:
            time_ns = min(self._next_ns, self._loop_ns)
            alive = self._powered and now_ns - time_ns < 1_000_000_000
            if time_ns == self._next_ns:
                self._next_ns += STREAM_NS
                if alive and SERVO_OUTPUT_RAW.number not in self._streams:
                    self._report(time_ns)
            else:
                self._loop_ns += round(1e9 / self.loop_hz)
                if alive:
                    self._loop(time_ns + round(1.5 * MS * self._rng.random()))
        return self._line.arrived(now_ns)

    def boot_ns(self, time_ns: int) -> int:
        """Its clock, time since boot [ns], at simulated `time_ns`."""
        elapsed = time_ns - self._origin_ns
        return BOOTED_NS + elapsed + round(elapsed * CLOCK_PPM * 1e-6)

    def _report(self, time_ns: int) -> None:
        if time_ns % 1_000_000_000 < STREAM_NS:
            self._send(time_ns, HEARTBEAT, 0, 1, 3, 81, 4, 3)
        self._stream(SERVO_OUTPUT_RAW, time_ns)

    def _loop(self, time_ns: int) -> None:
        for message in self._unpacker.feed(self._inward.arrived(time_ns)):
            if message.number == COMMAND_LONG.number:
                number, interval_us = int(message.fields[0]), float(message.fields[1])
                result = self._command(int(message.fields[7]), number, interval_us, time_ns)
                self._send(time_ns, COMMAND_ACK, int(message.fields[7]), result)
            elif message.number == TIMESYNC.number and not message.fields[0]:
                self._send(time_ns, TIMESYNC, self.boot_ns(time_ns), message.fields[1])
            elif message.number == PARAM_REQUEST_READ.number:
                name = text_of(message.fields[3])
                if name in ("INS_GYRO_FILTER", "INS_ACCEL_FILTER"):
                    self._send(time_ns, PARAM_VALUE, FILTER_HZ, 1200, 65535, name.encode(), 9)
        if SERVO_OUTPUT_RAW.number in self._streams and time_ns % 1_000_000_000 < 1e9 / self.loop_hz:
            self._send(time_ns, HEARTBEAT, 0, 1, 3, 81, 4, 3)
        for stream in STREAMS:
            interval, due = self._streams.get(stream.number, (0, 0))
            if interval and time_ns >= due:
                self._streams[stream.number] = interval, max(due + interval, time_ns)
                self._stream(stream, time_ns)

    def _command(self, command: int, number: int, interval_us: float, time_ns: int) -> int:
        known = {m.number for m in STREAMS} - self.without
        if command != SET_MESSAGE_INTERVAL or number not in known:
            return UNSUPPORTED
        interval_ms = int(interval_us / 1000)
        if interval_ms * 800 < 1e6 / self.loop_hz:
            words = f"Requested rate for message ID {number} too fast. Increase SCHED_LOOP_RATE"
            self._send(time_ns, STATUSTEXT, 4, words.encode()[:50])
            return DENIED
        self._streams[number] = interval_ms * MS, time_ns
        return ACCEPTED

    # ---------------------------------------------------------------------------------------- streams

    def _stream(self, message: Message, time_ns: int) -> None:
        fields = _FIELDS[message.number](self, time_ns)
        if self._line.behind_ns(time_ns) < BUFFER_NS:
            self._send(time_ns, message, *fields)

    def _send(self, time_ns: int, message: Message, *fields: float | bytes) -> None:
        self._line.send(self._packer.pack(message, *fields), time_ns)

    def _servos(self, time_ns: int) -> tuple[float, ...]:
        widths = [round(float(width) * 1e6) for width in self._inputs(time_ns)]
        return self.boot_ns(time_ns) // 1000 & 0xFFFFFFFF, *widths, 0, 0, 0

    def _inertial(self, time_ns: int) -> tuple[float, ...]:
        """Specific force [m/s2], rates [rad/s], field [gauss], temperature [K]."""
        names = (f"{s}_{a}" for s in ("accel", "gyro", "mag") for a in "xyz")
        row = np.array(self._at(*names, "imu_temperature")(time_ns - FILTER_DELAY_NS))
        models = self._models
        noise = (*models.imu.accel.noise, *models.imu.gyro.noise, *models.mag.field.noise)
        row[:9] += noise * self._rng.standard_normal(9)
        row[6:9] /= GAUSS
        return tuple(float(v) for v in row)

    def _highres(self, time_ns: int) -> tuple[float, ...]:
        *nine, kelvin = self._inertial(time_ns)
        (pascal,) = self._at("static_pressure")(time_ns)
        pressures = (pascal / 100.0, pascal / 100.0 - 950.0, 0.0)  # diff_pressure: relative to the ground's
        return self.boot_ns(time_ns) // 1000, *nine, *pressures, kelvin - ZERO_CELSIUS, 0xFFFF, 0

    def _rough(self, time_ns: int) -> tuple[float, ...]:
        *nine, kelvin = self._inertial(time_ns)
        units = (*[1e3 / GRAVITY] * 3, *[1e3] * 6)
        rounded = (int(v * u) for v, u in zip(nine, units, strict=True))
        return self.boot_ns(time_ns) // 1000, *rounded, 0, int((kelvin - ZERO_CELSIUS) * 100)

    def _attitude(self, time_ns: int) -> tuple[float, ...]:
        phi, theta, north, east = self._at("bank", "pitch", "heading_north", "heading_east")(time_ns)
        angles = np.array((phi, theta, math.atan2(east, north))) + self._level + 0.0005 * self._rng.standard_normal(3)
        rates = self._at("gyro_x", "gyro_y", "gyro_z")(time_ns)
        return self.boot_ns(time_ns) // MS, *(float(v) for v in (*angles, *rates))

    def _pressures(self, time_ns: int) -> tuple[float, ...]:
        if time_ns >= self._pitot[0]:
            pascal = self._at("pitot_pressure")(time_ns)[0] + self._models.pitot.noise_pa * self._rng.standard_normal()
            self._pitot = time_ns + PITOT_NS, pascal
        static, kelvin = self._at("static_pressure", "static_temperature")(time_ns)
        static += self._models.static.noise_pa * self._rng.standard_normal()
        celsius = round((kelvin - ZERO_CELSIUS) * 100)
        return self.boot_ns(time_ns) // MS, static / 100.0, self._pitot[1] / 100.0, celsius, celsius

    def _position(self, time_ns: int) -> tuple[float, ...]:
        position = self._at("latitude", "longitude", "altitude", "velocity_north", "velocity_east", "velocity_down")
        latitude, longitude, altitude, *velocity = (float(v) for v in position(time_ns))
        noise = 0.05 * self._rng.standard_normal(3)
        speeds = (round(100 * (v + n)) for v, n in zip(velocity, noise, strict=True))
        height = round(altitude * 1e3)
        return self.boot_ns(time_ns) // MS, round(latitude * 1e7), round(longitude * 1e7), height, 0, *speeds, 0

    def _receiver(self, time_ns: int) -> tuple[float, ...]:
        boot_ms, latitude, longitude, height, _, north, east, _, _ = self._position(time_ns)
        speed = round(math.hypot(north, east))
        return boot_ms * 1000, latitude, longitude, height, 70, 110, speed, 0, 3, 14, height, 1200, 2200, 150

    def _utc(self, time_ns: int) -> tuple[float, ...]:
        if time_ns - self._origin_ns < UTC_AFTER_NS and self.start_utc_ns:
            return 0, self.boot_ns(time_ns) // MS
        return (self.start_utc_ns + time_ns - self._origin_ns) // 1000, self.boot_ns(time_ns) // MS


_FIELDS: dict[int, Callable[[Autopilot, int], tuple[float, ...]]] = {
    HIGHRES_IMU.number: Autopilot._highres,
    RAW_IMU.number: Autopilot._rough,
    ATTITUDE.number: Autopilot._attitude,
    SCALED_PRESSURE.number: Autopilot._pressures,
    GLOBAL_POSITION_INT.number: Autopilot._position,
    GPS_RAW_INT.number: Autopilot._receiver,
    SYSTEM_TIME.number: Autopilot._utc,
    SERVO_OUTPUT_RAW.number: Autopilot._servos,
}
