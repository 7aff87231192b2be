"""u-blox GPS receiver on a serial port: one NAV-PVT for each fix.

Interface descriptions as in `daq.sensors.ubx`. Units are the receiver's (1e-7 deg, mm, mm/s). Each fix is reported in
exactly one scan; scans between fixes carry no GPS values and are not faults.

Self-test: a NAV-PVT arrives within two seconds of set-up. Plausibility: no fix for three intervals is stale, no byte for two
seconds absent; a fix the receiver itself does not vouch for (gnssFixOK clear, or not 3-D) is recorded as recovering.
"""

from collections import deque
from collections.abc import Callable, Generator
from typing import Annotated, Literal

from pydantic import Field

from daq.contract.scan import RawValue, SensorState
from daq.sensors.base import MS, SECOND, Driver, DriverContext, Reading, SelfTestError, SensorSection, Wait
from daq.sensors.bus import SerialPortCalls
from daq.sensors.timebase import ROLLOVER_NS, TimeBase, rollovers
from daq.sensors.ubx import ACK_ACK, ACK_NAK, NAV_PVT, NavPvt, UbxParser, parse_nav_pvt, setup_m8, setup_m9

_SETUP = {"m9": setup_m9, "m8": setup_m8}
_BACKLOG = 32
_READ_LIMIT = 4096
_ANSWER_LOOKS = 20  # of 5 ms: receivers answer within a navigation epoch, mostly in 10 ms; older ones not at all
_SILENT = 2 * SECOND
_FIX_3D = (3, 4)


class GnssConfig(SensorSection):
    """`[sensors.gnss]`: u-blox receiver.

    generation: how it is told what to send; `m9` (and M10) by CFG-VALSET, `m8` by the older messages, `none` leaves
    the receiver as it was set up. latency_s: from the instant of a fix to the first byte of its message, the receiver's
    computing time; the time on the line follows from `baud`. No data sheet states it: measure it once against a pulse.
    pps: sysfs file of the kernel's pulse-per-second stamps, e.g. /sys/class/pps/pps0/assert.
    """

    driver: str = "ublox"
    device: str = "/dev/serial0"
    baud: Annotated[int, Field(ge=9600)] = 115200
    rate_hz: Annotated[float, Field(gt=0, le=25)] = 10.0
    generation: Literal["m9", "m8", "none"] = "m9"
    latency_s: Annotated[float, Field(ge=0, le=1)] = 0.05
    pps: str | None = None

    @property
    def arrival_s(self) -> float:
        """From the instant of a fix to the last byte of its NAV-PVT message: 100 bytes of ten bits [s]."""
        return self.latency_s + 1000.0 / self.baud


class Ublox(Driver):
    """GPS position, velocity and time [receiver units]; feeds the relation of the two clocks."""

    name, groups, group = "ublox", ("gnss",), "gnss"
    uses_i2c = False

    def __init__(
        self, config: GnssConfig, port: SerialPortCalls, now_ns: Callable[[], int], timebase: TimeBase
    ) -> None:
        self._config = config
        self._port = port
        self._now = now_ns
        self._timebase = timebase
        self._parser = UbxParser()
        self._answers: deque[bool] = deque(maxlen=_BACKLOG)  # to settings: whether they were taken
        self._nmea = False
        self._rollovers = 0  # of its week number, by what it says and when this was written
        self._backlog: deque[tuple[NavPvt, int]] = deque(maxlen=_BACKLOG)
        self._last_byte_ns = self._last_fix_ns = now_ns()
        # A fix is missing once it should have been seen at the scan before; receivers are some ten milliseconds uneven.
        self._stale_after = round(SECOND / config.rate_hz) + max(3 * timebase.poll_ns // 2, 50 * MS)

    @classmethod
    def build(cls, group: str, context: DriverContext) -> Driver:
        port = context.need_port(context.gnss, group)
        return cls(context.section(group), port, context.now_ns, context.timebase)

    def initialise(self) -> Generator[Wait, None, None]:
        setup = _SETUP.get(self._config.generation)
        messages = setup(self._config.rate_hz) if setup else []
        rejected: list[int] = []
        answered = 0
        for number, message in enumerate(messages):
            self._answers.clear()
            self._port.write(message)
            for _ in range(_ANSWER_LOOKS):
                yield 5 * MS
                self._receive()
                if self._answers:
                    break
            answered += bool(self._answers)
            if self._answers and not self._answers.pop():
                rejected.append(number)
        if 0 < answered < len(messages):  # it came back, or lost a byte, while it was being set up
            raise SelfTestError(
                f"the GPS receiver answered {answered} of {len(messages)} settings only; it is set up again"
            )
        self._check_answers(messages, rejected)
        self._backlog.clear()
        self._last_byte_ns = self._now()
        for _ in range(40):
            self._receive()
            if self._backlog:
                return
            yield 50 * MS
        silent = self._last_byte_ns + _SILENT <= self._now()
        if not silent and self._nmea:
            raise SelfTestError(
                f"no NAV-PVT from the GPS receiver on {self._config.device} in 2 s, only NMEA: its port is not configured;"
                " check generation, or save NAV-PVT for this port in u-center"
            )
        raise SelfTestError(
            f"no {'byte' if silent else 'NAV-PVT'} from the GPS receiver on {self._config.device} in 2 s;"
            " check wiring, baud rate and generation"
        )

    def _check_answers(self, messages: list[bytes], refused: list[int]) -> None:
        """Rate and dynamic model must be taken; of the ports' keys those of a port that the receiver has not may be refused."""
        if self._config.generation == "m9":
            essential = bool(refused) and (refused[0] == 0 or len(refused) == len(messages))
        else:
            essential = bool(refused)
        if essential:
            raise SelfTestError(
                f"the GPS receiver on {self._config.device} refuses (NAK) its rate, dynamic model or outputs:"
                " correct sensors.gnss.generation, or set it up in u-center and write generation = 'none'"
            )

    def _receive(self) -> None:
        available = min(self._port.in_waiting, _READ_LIMIT)
        if not available:
            return
        now_ns = self._now()
        self._last_byte_ns = now_ns
        data = self._port.read(available)
        self._nmea = self._nmea or b"$G" in data
        for message, payload in self._parser.feed(data):
            if message in (ACK_ACK, ACK_NAK):
                self._answers.append(message == ACK_ACK)
            elif message == NAV_PVT and len(payload) == 92:
                fix = parse_nav_pvt(payload)
                self._rollovers = rollovers(fix.utc_ns) if fix.utc_ns else self._rollovers
                fix = fix._replace(utc_ns=fix.utc_ns and fix.utc_ns + self._rollovers * ROLLOVER_NS)
                self._last_fix_ns = now_ns
                self._backlog.append((fix, now_ns))
                if fix.utc_ns:
                    self._timebase.observe_fix(now_ns, fix.utc_ns, fix.time_accuracy_ns)

    def read(self) -> Reading:
        self._receive()
        if self._backlog:
            return self._report(*self._backlog.popleft())
        now_ns = self._now()
        if now_ns - self._last_byte_ns > _SILENT:
            return Reading(state=SensorState.ABSENT, detail="GPS receiver is silent")
        if now_ns - self._last_fix_ns > self._stale_after:
            return Reading(state=SensorState.STALE, detail="GPS receiver sends no fix")
        return Reading()

    def _report(self, fix: NavPvt, received_ns: int) -> Reading:
        values: dict[str, RawValue] = {
            "gnss_itow": fix.itow_ms,
            "gnss_utc_ns": fix.utc_ns,
            "gnss_fix": fix.fix,
            "gnss_satellites": fix.satellites,
            "latitude_e7": fix.latitude_e7,
            "longitude_e7": fix.longitude_e7,
            "height_msl_mm": fix.height_msl_mm,
            "velocity_north_mm": fix.velocity_north_mm,
            "velocity_east_mm": fix.velocity_east_mm,
            "velocity_down_mm": fix.velocity_down_mm,
            "time_accuracy_ns": fix.time_accuracy_ns,
            "horizontal_accuracy_mm": fix.horizontal_accuracy_mm,
            "vertical_accuracy_mm": fix.vertical_accuracy_mm,
            "speed_accuracy_mm": fix.speed_accuracy_mm,
        }
        time_ns = (self._timebase.monotonic_ns(fix.utc_ns) if fix.utc_ns else None) or (
            received_ns - round(self._config.arrival_s * SECOND)
        )
        if fix.fix not in _FIX_3D or not fix.fix_ok:
            return Reading(values, SensorState.RECOVERING, "GPS receiver has no 3-D fix", time_ns)
        return Reading(values, time_ns=time_ns)

    def intact(self) -> bool:
        """Whether fixes still come; a receiver that lost its settings sends something else, or nothing."""
        return self._now() - self._last_fix_ns <= _SILENT

    def metadata(self) -> dict[str, str]:
        facts = {"chip": "u-blox", "rate_hz": repr(self._config.rate_hz), "latency_s": repr(self._config.latency_s)}
        return {**facts, "rollovers": str(self._rollovers)} if self._rollovers else facts
