"""The live view: a thread that logs to rerun, fed through a bounded queue that drops the oldest entries.

The ground station's receiver never waits for the view: `LiveView` calls return at once, and when the viewer is slow the
oldest pictures are dropped and counted. Recordings are independent of it and lose nothing. The gRPC server to which viewers
connect runs in this process, on loopback, with bounded memory; viewers may connect and disconnect at any time. Each start makes
a new recording id, because a viewer shows an old recording for a known id.
"""

import queue
import threading
import uuid
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from pathlib import Path

import rerun as rr

from daq.identification.airframe import EQUATIONS
from groundstation.identification.session import LiveState
from groundstation.receiver.events import LinkStatistics
from groundstation.viewer import entities as e
from groundstation.viewer.blueprint import Layout, blueprint, fitted
from groundstation.viewer.entities import LinkSample
from groundstation.viewer.gate import LOOPBACK, ViewerError, ViewerGate, free_port, hidden_address, port_is_free
from groundstation.viewer.scene import Scene

DEFAULT_PORT = 9876
QUEUE_LENGTH = 600  # pictures: some ten seconds at 20 scans a second
TICK_S: Mapping[str, float] = {"full": 0.5, "light": 1.0, "phone": 1.0}
"""Interval of packets to viewers [s]. At ten packets a second a browser that draws by software on two busy cores lags by 11 to
14 s, at four sometimes too; at two it lags by a second."""
FLUSH_TIMEOUT_S = 5.0  # for the queue to empty when the view is closed


@dataclass(frozen=True, slots=True)
class ViewOptions:
    """Options of a live view.

    port: gRPC port on loopback. memory_limit: of the server. rrd: file to write, besides the server or, without `serve`, instead.
    open_port: whether further viewers of this computer may connect to `port`; else a viewer needs the hidden address. tick_s: how
    long pictures are collected before they are sent together; None as suits the layout. When flight time runs faster than real
    time it should be shorter by the same factor, or every packet holds minutes. coefficients: whose derivatives are drawn.
    """

    layout: Layout = "full"
    port: int = DEFAULT_PORT
    memory_limit: str = "64MiB"
    rrd: Path | None = None
    serve: bool = True
    open_port: bool = True
    tick_s: float | None = None
    coefficients: tuple[str, ...] = tuple(EQUATIONS)


class LiveView:
    """One aircraft, live. Methods may be called from any thread and never block."""

    def __init__(self, title: str, options: ViewOptions, columns: tuple[str, ...] | None = None) -> None:
        if options.serve and not port_is_free(options.port):
            raise ViewerError(
                f"viewer port {LOOPBACK}:{options.port} is in use; close the other viewer or give another port"
            )
        self._queue: queue.Queue[Callable[[Scene], None] | None] = queue.Queue(QUEUE_LENGTH)
        self.dropped = 0  # pictures, because the viewer side was slow
        self.shown = 0  # pictures handed to rerun
        self._closing = False
        config = rr.ChunkBatcherConfig(flush_tick=options.tick_s or TICK_S[options.layout])
        run = f"{title}-{uuid.uuid4().hex[:12]}"
        self._stream = rr.RecordingStream(e.APPLICATION, recording_id=run, batcher_config=config)
        sinks: list[rr.GrpcServerSink | rr.FileSink] = []
        self.url = ""
        self._gate: ViewerGate | None = None
        if options.serve:
            hidden, port = hidden_address(), free_port()
            server = rr.GrpcServerSink(bind_ip=hidden, port=port, server_memory_limit=options.memory_limit)
            self.url = server.uri
            sinks.append(server)
            if options.open_port:
                self._gate = ViewerGate(options.port, (hidden, port))
                self.url = f"rerun+http://{LOOPBACK}:{options.port}/proxy"
        if options.rrd is not None:
            sinks.append(rr.FileSink(str(options.rrd), write_footer=False))
        if not sinks:
            raise ViewerError("nothing to show to: neither a server nor a file was asked for")
        page = blueprint(options.layout, live=True, coefficients=options.coefficients)
        self._stream.set_sinks(*sinks, default_blueprint=fitted(page, live=True, layout=options.layout))
        self._columns = columns
        self._thread = threading.Thread(target=self._run, name="viewer", daemon=True)
        self._thread.start()

    # ------------------------------------------------------------------------------------------------ callers' side
    def sample(self, time_s: float, values: Mapping[str, float]) -> None:
        self._put(lambda scene: scene.sample(time_s, values))

    def states(self, time_s: float, states: Mapping[str, str]) -> None:
        self._put(lambda scene: scene.states(time_s, states))

    def event(self, time_s: float, text: str, level: str = "INFO") -> None:
        self._put(lambda scene: scene.event(time_s, text, level))

    def link(self, time_s: float, link: LinkSample) -> None:
        self._put(lambda scene: scene.link(time_s, link))

    def quality(self, time_s: float, report: LinkStatistics) -> None:
        sample = LinkSample.reported(report.loss, report.scan_rate_hz, report.rssi_dbm, report.latency_s)
        self.link(time_s, sample)

    def status(self, time_s: float, markdown: str) -> None:
        self._put(lambda scene: scene.status(time_s, markdown))

    def readouts(self, time_s: float, numbers: str, alarms: str, level: str) -> None:
        """Show the digital read-outs, the alarms in force and the highest level among them ("" for none)."""
        self._put(lambda scene: scene.readouts(time_s, numbers, alarms, level))

    def identification(self, state: LiveState) -> None:
        self._put(lambda scene: scene.identification(state))

    def close(self) -> None:
        """Show what is queued, then stop."""
        if self._closing:
            return
        self._closing = True
        try:
            self._queue.put(None, timeout=FLUSH_TIMEOUT_S)
        except queue.Full:  # the viewer side hangs: give up the pictures, not the ground station
            self._drop_oldest()
            self._queue.put_nowait(None)
        self._thread.join(FLUSH_TIMEOUT_S)
        if self._gate is not None:
            self._gate.close()
        self._stream.disconnect()

    def _put(self, job: Callable[[Scene], None]) -> None:
        if self._closing:
            return
        while True:
            try:
                self._queue.put_nowait(job)
                return
            except queue.Full:
                self._drop_oldest()

    def _drop_oldest(self) -> None:
        try:
            self._queue.get_nowait()
            self.dropped += 1
        except queue.Empty:
            pass

    # ------------------------------------------------------------------------------------------------ viewer's side
    def _run(self) -> None:
        scene = Scene(self._stream, self._columns)
        while (job := self._queue.get()) is not None:
            job(scene)
            self.shown += 1
