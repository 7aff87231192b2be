"""An ArduPilot or PX4 as a sensor: IMU, compass, attitude, pitot, static pressure, GPS and servo outputs from its messages.

The physical values of MAVLink common.xml are converted to the counts of the chip that each group otherwise has, so that
everything after the driver works as with a chip; `metadata` has the scales. Each sample carries the autopilot's own time. A scan
without a new sample repeats the last one, and its offset says how old it is.

HIGHRES_IMU, or RAW_IMU (mG, mrad/s) where an autopilot has none. ArduPilot's are behind INS_GYRO_FILTER and INS_ACCEL_FILTER,
low passes of second order with a delay of sqrt(2) / (2 pi f); their frequencies f are read. PX4's are not filtered. Pitot:
SCALED_PRESSURE, from which the autopilot has subtracted its zero (diff_pressure of ArduPilot's HIGHRES_IMU is the barometer's).
Position and velocity: GLOBAL_POSITION_INT, while GPS_RAW_INT reports a fix. UTC: SYSTEM_TIME.

Self-test: a message of each group within two seconds. Plausibility: checksum, ranges; no sample for half a second is stale.
"""

import math
from collections.abc import Callable, Generator, Mapping, Sequence
from typing import Annotated, Any, ClassVar, NamedTuple

from pydantic import Field

from daq.contract.channels import CHANNEL_BY_NAME
from daq.contract.scan import RawValue, SensorState
from daq.sensors.autopilot_line import (
    ATTITUDE,
    BYTES,
    GLOBAL_POSITION_INT,
    GPS_RAW_INT,
    HIGHRES_IMU,
    LINE_SHARE,
    NAMES,
    RAW_IMU,
    SCALED_PRESSURE,
    SERVO_OUTPUT_RAW,
    SLOW_BYTES_PER_S,
    SYSTEM_TIME,
    AutopilotLine,
    AutopilotMessage,
    MessageWish,
)
from daq.sensors.base import MS, SECOND, Driver, DriverContext, Reading, SelfTestError, SensorConfigSection, Wait
from daq.sensors.icm20948 import COUNTS_PER_DPS, COUNTS_PER_G
from daq.sensors.ms4525do import nominal_transfer
from daq.sensors.timebase import EARLIEST_UTC_NS
from daq.utilities.constants import GRAVITY, ZERO_CELSIUS

STALE_NS = SECOND // 2
SAMPLES_PER_SCAN = 1.5
"""Requested, where the line can carry it, so that with the jitter of both loops every scan has a new sample."""
GNSS_HZ, TIME_HZ = 10.0, 2.0
STATIC_PA, STATIC_K = 0.01, 0.01
"""One count of the static pressure [Pa] and of its temperature [K]: the resolution of the message."""
_UTC_SIGMA_NS = MS  # of SYSTEM_TIME, which has whole milliseconds since the start-up
_FILTERS = {"accel": "INS_ACCEL_FILTER", "gyro": "INS_GYRO_FILTER"}
_FIXES = {2: 2, 3: 3, 4: 3, 5: 3, 6: 3}  # GPS_FIX_TYPE: differential and RTK are fixes in three dimensions
_GAUSS = 1e-4  # T


class AutopilotSection(SensorConfigSection):
    """`[sensors.autopilot]`: the line to it. Groups with `driver = "autopilot"` are read over it."""

    device: str = "/dev/serial/by-id/usb-ArduPilot"
    baud: Annotated[int, Field(ge=9600)] = 115200


class AutopilotSample(NamedTuple):
    """values: channel -> count; fault: what is wrong with them, empty where nothing is."""

    values: Mapping[str, RawValue]
    fault: str = ""


def carried_hz(baud: int, groups: Sequence[str]) -> float:
    """Rate [Hz] at which a line of a baud rate can carry a sample of each of the groups."""
    cycle = sum(BYTES.get(m, 0) for m in {_MESSAGES[g][0] for g in groups})
    return max(1.0, (LINE_SHARE * baud / 10 - SLOW_BYTES_PER_S) / max(cycle, 1))


class AutopilotGroup(Driver):
    """A group of channels out of the autopilot's messages."""

    name = "autopilot"
    groups: ClassVar[tuple[str, ...]] = ("imu", "mag", "attitude", "pitot", "static", "capture", "gnss")
    uses_i2c = False

    def __init__(self, group: str, context: DriverContext, line: AutopilotLine) -> None:
        self.group = group
        self._section, self._line, self._context, self._now = context.section(group), line, context, context.now_ns
        rate = min(context.rate_hz, self.max_rate_hz)
        messages = _MESSAGES[group]
        carried = carried_hz(self._line_baud(context), [g for g in _MESSAGES if self._is_read(g, context)])
        rates = tuple(r for r in (SAMPLES_PER_SCAN * rate, rate, rate / 2) if r <= carried) or (carried,)
        self._wishes: list[MessageWish] = [line.want(messages, *(rates if group != "gnss" else (GNSS_HZ, GNSS_HZ / 2)))]
        if carried < rate and group != "gnss":
            words = f"{self._line_baud(context)} baud carry {carried:.0f} of {rate:.0f} samples a second"
            self._wishes[0].refusal = f"{words}: raise the baud rate (USB: write 921600), or lower scan.rate_hz"
        if group == "gnss":
            self._wishes += [line.want((GPS_RAW_INT,), GNSS_HZ / 2), line.want((SYSTEM_TIME,), TIME_HZ)]
        self._seen_ns = self._time_ns = 0

    @classmethod
    def build(cls, group: str, context: DriverContext) -> Driver:
        port = context.need_port(context.autopilot, "autopilot")
        section = context.section("autopilot")
        device = section.device if section is not None else "its port"
        names = tuple(_FILTERS.values()) if getattr(context.section("imu"), "driver", "") == cls.name else ()
        line = context.shared.setdefault("autopilot", AutopilotLine(port, context.now_ns, device, names))
        return cls(group, context, line)

    @classmethod
    def _is_read(cls, group: str, context: DriverContext) -> bool:
        return getattr(context.section(group), "driver", "") == cls.name

    def _line_baud(self, context: DriverContext) -> int:
        return int(context.section("autopilot").baud)

    def initialise(self) -> Generator[Wait, None, None]:
        asked_ns = self._now()
        for _ in range(40):
            self._line.poll()
            if (newest := self._newest()) is not None and newest.arrived_ns > asked_ns:
                for _ in range(
                    20 if self.group == "imu" else 0
                ):  # a second for the filters' parameters; a PX4 has none of these
                    if self._line.complete:
                        return
                    yield 50 * MS
                    self._line.poll()
                return
            yield 50 * MS
        wish = self._wishes[0]
        words = f": {wish.refusal}" if wish.refusal else "; set its stream rate and baud rate"
        raise SelfTestError(f"no {NAMES[wish.message]} from the autopilot on {self._line.device} in 2 s{words}")

    def _newest(self) -> AutopilotMessage | None:
        return self._line.newest(self._wishes[0].message)

    def read(self) -> Reading:
        self._line.poll()
        self.refusal = "; ".join(w.refusal for w in self._wishes if w.refusal)
        newest, message = self._newest(), NAMES[self._wishes[0].message]
        if newest is None:
            return Reading(state=SensorState.STALE, detail=f"autopilot sends no {message}")
        age_ns = self._now() - newest.sampled_ns
        if age_ns > STALE_NS:
            return Reading(state=SensorState.STALE, detail=f"autopilot's {message} is {age_ns * 1e-9:.1f} s old")
        if self.group == "gnss":
            return self._fix(newest)
        values, fault = _SAMPLES[self.group](self, newest.fields)
        return Reading(values, SensorState.OUT_OF_RANGE if fault else SensorState.OK, fault, newest.sampled_ns)

    def intact(self) -> bool:
        """Whether samples still come."""
        newest = self._newest()
        return newest is not None and self._now() - newest.arrived_ns < STALE_NS

    # ---------------------------------------------------------------------------------------- samples by group

    def _imu_sample(self, f: tuple[Any, ...]) -> AutopilotSample:
        raw_units = self._wishes[0].message == RAW_IMU  # mG, mrad/s, 0.01 degC
        force, rate = (GRAVITY * 1e-3, 1e-3) if raw_units else (1.0, 1.0)
        per_force = COUNTS_PER_G[self._section.accel_range_g] / GRAVITY
        per_rate = math.degrees(COUNTS_PER_DPS[self._section.gyro_range_dps])
        values = {f"accel_{a}": round(v * force * per_force) for a, v in zip("xyz", f[1:4], strict=True)}
        values |= {f"gyro_{a}": round(v * rate * per_rate) for a, v in zip("xyz", f[4:7], strict=True)}
        celsius = f[11] * 0.01 if raw_units else f[13]
        die = CHANNEL_BY_NAME["imu_temperature"].count_of(celsius + ZERO_CELSIUS)
        return _bounded({**values, "imu_temperature": die})

    def _mag_sample(self, f: tuple[Any, ...]) -> AutopilotSample:
        gauss = 1e-3 if self._wishes[0].message == RAW_IMU else 1.0
        per_count = (CHANNEL_BY_NAME["mag_x"].scale or 1.0) / _GAUSS
        field = {f"mag_{a}": round(v * gauss / per_count) for a, v in zip("xyz", f[7:10], strict=True)}
        return _bounded({**field, "mag_status": 0})

    def _attitude_sample(self, f: tuple[Any, ...]) -> AutopilotSample:
        (cr, cp, cy), (sr, sp, sy) = ([g(a / 2) for a in f[1:4]] for g in (math.cos, math.sin))
        quaternion = (
            cr * cp * cy + sr * sp * sy,
            sr * cp * cy - cr * sp * sy,
            cr * sp * cy + sr * cp * sy,
            cr * cp * sy - sr * sp * cy,
        )
        parts = {f"quaternion_{a}": round(v * 32767) for a, v in zip("wxyz", quaternion, strict=True)}
        return _bounded({**parts, "attitude_status": 0})

    def _pitot_sample(self, f: tuple[Any, ...]) -> AutopilotSample:
        per_count, at_zero = nominal_transfer(self._section)
        kelvin = (
            f[4] or f[3]
        ) * 0.01 + ZERO_CELSIUS  # of the differential sensor where it has one, else of the barometer
        temperature = CHANNEL_BY_NAME["pitot_temperature"].count_of(kelvin)
        return _bounded(
            {"pitot_pressure": round((f[2] * 100.0 - at_zero) / per_count), "pitot_temperature": temperature}
        )

    def _static_sample(self, f: tuple[Any, ...]) -> AutopilotSample:
        kelvin = f[3] * 0.01 + ZERO_CELSIUS
        return _bounded(
            {"static_pressure": round(f[1] * 100.0 / STATIC_PA), "static_temperature": round(kelvin / STATIC_K)}
        )

    def _servo_sample(self, f: tuple[Any, ...]) -> AutopilotSample:
        widths = f[1:7]
        undriven = [f"pwm_{i + 1}" for i in range(self._section.pwm_inputs) if not widths[i]]
        fault = f"autopilot does not drive {', '.join(undriven)}" if undriven else ""
        return AutopilotSample({f"pwm_{i}": int(w) * 10 for i, w in enumerate(widths, start=1) if w}, fault)

    def _fix(self, newest: AutopilotMessage) -> Reading:
        """A position, in one scan only as from a receiver, with its UTC where the autopilot knows it."""
        self._report_utc()
        if newest.sampled_ns <= self._seen_ns:
            return Reading()
        self._seen_ns = newest.sampled_ns
        raw = self._line.newest(GPS_RAW_INT)
        if raw is None or self._now() - raw.arrived_ns > 2 * SECOND:
            return Reading(state=SensorState.STALE, detail="autopilot sends no GPS_RAW_INT")
        g, r = newest.fields, raw.fields
        utc_ns, accuracy_ns = self._context.timebase.utc(newest.sampled_ns)
        values: dict[str, RawValue] = {
            **{"gnss_utc_ns": utc_ns, "gnss_fix": _FIXES.get(int(r[8]), 0), "gnss_satellites": r[9]},
            **{"latitude_e7": g[1], "longitude_e7": g[2], "height_msl_mm": g[3], "time_accuracy_ns": accuracy_ns},
            **{f"velocity_{a}_mm": 10 * g[i] for i, a in enumerate(("north", "east", "down"), start=5)},
            **{f"{a}_accuracy_mm": r[i] for i, a in enumerate(("horizontal", "vertical", "speed"), start=11) if r[i]},
        }
        if values["gnss_fix"] != _FIXES[3]:
            return Reading(values, SensorState.RECOVERING, "autopilot's GPS has no 3-D fix", newest.sampled_ns)
        return Reading(values, time_ns=newest.sampled_ns)

    def _report_utc(self) -> None:
        """Pass a new SYSTEM_TIME to the time base."""
        message = self._line.newest(SYSTEM_TIME)
        if message is None or message.sampled_ns <= self._time_ns:
            return
        self._time_ns = message.sampled_ns
        utc_ns = int(message.fields[0]) * 1000
        if utc_ns > EARLIEST_UTC_NS:  # before a fix it counts from the start-up, or from 1970
            sigma = math.hypot(_UTC_SIGMA_NS, self._line.clock.accuracy_ns)
            self._context.timebase.observe_instant(message.sampled_ns, utc_ns, round(sigma))

    def metadata(self) -> dict[str, str]:
        facts = {"chip": f"MAVLink {NAMES[self._wishes[0].message]}", "stamped": "sender"}
        if self.group == "capture":
            facts["scale_s"] = "1e-07"
        elif self.group == "pitot":
            facts["scale_pa"], facts["offset_pa"] = (repr(v) for v in nominal_transfer(self._section))
        elif self.group == "static":
            facts |= {"scale_pa": repr(STATIC_PA), "scale_k": repr(STATIC_K)}
        elif self.group == "imu":
            facts["accel_scale_m_s2"] = repr(GRAVITY / COUNTS_PER_G[self._section.accel_range_g])
            facts["gyro_scale_rad_s"] = repr(math.radians(1 / COUNTS_PER_DPS[self._section.gyro_range_dps]))
            for sensor, name in _FILTERS.items():
                if (hertz := self._line.parameters.get(name, 0.0)) > 0:
                    facts[f"{sensor}_delay_s"] = repr(round(math.sqrt(2) / (2 * math.pi * hertz), 6))
        return facts


class MavlinkServo(AutopilotGroup):
    """Servo outputs alone, over a port that the group's own section names."""

    name, groups = "mavlink_servo", ("capture",)
    max_rate_hz = 50.0

    def _line_baud(self, context: DriverContext) -> int:
        return int(self._section.baud)

    @classmethod
    def build(cls, group: str, context: DriverContext) -> Driver:
        port = context.need_port(context.autopilot, group)
        return cls(group, context, AutopilotLine(port, context.now_ns, context.section(group).device))


SENDERS = (AutopilotGroup.name, MavlinkServo.name)
"""Drivers whose samples carry the sender's own time."""

_MESSAGES: Mapping[str, tuple[int, ...]] = {
    "imu": (HIGHRES_IMU, RAW_IMU),
    "mag": (HIGHRES_IMU, RAW_IMU),
    "attitude": (ATTITUDE,),
    "pitot": (SCALED_PRESSURE,),
    "static": (SCALED_PRESSURE,),
    "capture": (SERVO_OUTPUT_RAW,),
    "gnss": (GLOBAL_POSITION_INT,),
}
"""Group -> messages that have its samples, in order of preference."""
_SAMPLES: Mapping[str, Callable[[AutopilotGroup, tuple[Any, ...]], AutopilotSample]] = {
    "imu": AutopilotGroup._imu_sample,
    "mag": AutopilotGroup._mag_sample,
    "attitude": AutopilotGroup._attitude_sample,
    "pitot": AutopilotGroup._pitot_sample,
    "static": AutopilotGroup._static_sample,
    "capture": AutopilotGroup._servo_sample,
}


def _bounded(values: dict[str, int]) -> AutopilotSample:
    """The values limited to the range of their channels; a limited one is a fault."""
    clipped = []
    for name, value in values.items():
        low, high = CHANNEL_BY_NAME[name].limits()
        if not low <= value <= high:
            clipped.append(name)
            values[name] = int(min(max(value, low), high))
    return AutopilotSample(values, f"autopilot's {clipped[0]} is beyond its range" if clipped else "")
