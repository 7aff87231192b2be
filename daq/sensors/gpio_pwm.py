"""Servo pulses at GPIO lines, timed by the kernel: no co-processor needed.

Edge events of the GPIO character device (uAPI v2, Linux 5.10; package `gpiod` 2) carry the monotonic time of their interrupt,
so a pulse is falling less rising edge whatever the scan does in between; what is left is the jitter of interrupts, microseconds
on an idle machine. Levels above 3.3 V need a divider.

Self-test: the lines can be had, and pulses on those that are wired. Plausibility: widths of 500 to 2500 us; no pulse for
`timeout_ms`; events whose numbers have a gap (the kernel's queue was full) make no pulse.
"""

from collections.abc import Callable, Generator, Sequence
from typing import NamedTuple, Protocol

from daq.contract.scan import RawValue, SensorState
from daq.sensors.base import MS, US, Driver, DriverConfigError, DriverContext, Reading, SelfTestError, Wait
from daq.sensors.capture import CaptureConfig

SHORTEST, LONGEST = 500 * US, 2500 * US


class LineEdge(NamedTuple):
    """An edge at a line: whether it rose, monotonic time [ns], number of the event on its line, from 1."""

    line: int
    rising: bool
    time_ns: int
    number: int


class EdgeSource(Protocol):
    """Where edges come from."""

    def edges(self) -> Sequence[LineEdge]:
        """Those since the last call, in their order; never waits. Raises OSError where the lines are gone."""
        ...


class KernelEdges:
    """Edge events of lines of a GPIO chip. Raises OSError where they cannot be had, DriverConfigError without the package."""

    QUEUE = 1024  # events: six lines at 333 Hz for a quarter of a second

    def __init__(self, chip: str, lines: Sequence[int]) -> None:
        try:
            import gpiod
        except ImportError:
            raise DriverConfigError(
                "key sensors.capture.driver: 'gpio' needs the package gpiod (pip install 'gpiod>=2')"
            ) from None
        line = gpiod.line
        settings = gpiod.LineSettings(
            direction=line.Direction.INPUT, edge_detection=line.Edge.BOTH, event_clock=line.Clock.MONOTONIC
        )
        self._rising = gpiod.EdgeEvent.Type.RISING_EDGE
        self._request = gpiod.request_lines(
            chip, consumer="sideslip", config={tuple(lines): settings}, event_buffer_size=self.QUEUE
        )

    def edges(self) -> Sequence[LineEdge]:
        if not self._request.wait_edge_events(0):
            return ()
        return [
            LineEdge(e.line_offset, e.event_type is self._rising, e.timestamp_ns, e.line_seqno)
            for e in self._request.read_edge_events(self.QUEUE)
        ]


class GpioPwm(Driver):
    """Pulse widths [0.1 us] of up to six lines, in the order of `lines`."""

    name, groups, uses_i2c = "gpio", ("capture",), False
    max_rate_hz = 45.0

    def __init__(
        self,
        config: CaptureConfig,
        now_ns: Callable[[], int],
        open_lines: Callable[[str, Sequence[int]], EdgeSource] = KernelEdges,
    ) -> None:
        self.group = self.groups[0]
        self._config, self._now, self._open = config, now_ns, open_lines
        self._source: EdgeSource | None = None
        self._forget()

    @classmethod
    def build(cls, group: str, context: DriverContext) -> Driver:
        return cls(context.section(group), context.now_ns)

    def _forget(self) -> None:
        self._rose: dict[int, LineEdge] = {}
        self._numbers: dict[int, int] = {}
        self._pulses: dict[int, tuple[int, int]] = {}  # width and end [ns], by line

    def initialise(self) -> Generator[Wait, None, None]:
        self._forget()
        self._source = self._source or self._open(self._config.chip, self._config.lines)
        self._source.edges()
        yield 2 * self._config.timeout_ms * MS
        self._take()
        if self._config.lines and not self._pulses:
            lines = ", ".join(map(str, self._config.lines))
            raise SelfTestError(f"no servo pulse on lines {lines} of {self._config.chip}; check wiring and ground")

    def _take(self) -> None:
        assert self._source is not None
        for edge in self._source.edges():
            gap = edge.number != self._numbers.get(edge.line, edge.number - 1) + 1
            self._numbers[edge.line] = edge.number
            rose = self._rose.pop(edge.line, None)
            if edge.rising:
                self._rose[edge.line] = edge
            elif rose is not None and not gap and SHORTEST <= edge.time_ns - rose.time_ns <= LONGEST:
                self._pulses[edge.line] = edge.time_ns - rose.time_ns, edge.time_ns

    def read(self) -> Reading:
        try:
            self._take()
        except OSError:
            self._source = None  # unplugged: asked for again at the next set-up
            raise
        now_ns = self._now()
        values: dict[str, RawValue] = {}
        ends: list[int] = []
        for number, line in enumerate(self._config.lines, start=1):
            width, end_ns = self._pulses.get(line, (0, 0))
            if width and now_ns - end_ns <= self._config.timeout_ms * MS:
                values[f"pwm_{number}"] = round(width / 100)
                ends.append(end_ns)
        if not values:
            return Reading(state=SensorState.STALE, detail="no servo pulse on any line")
        time_ns = sum(ends) // len(ends)
        silent = [f"pwm_{i}" for i in range(1, len(self._config.lines) + 1) if f"pwm_{i}" not in values]
        if silent:
            return Reading(values, SensorState.OUT_OF_RANGE, f"no valid pulses on {', '.join(silent)}", time_ns)
        return Reading(values, time_ns=time_ns)

    def metadata(self) -> dict[str, str]:
        return {"chip": f"GPIO lines of {self._config.chip}", "scale_s": "1e-07"}
