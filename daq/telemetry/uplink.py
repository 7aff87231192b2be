"""Commands and requests from the ground: checked, answered once, harmless when repeated.

With a signing key set, only frames with a good signature do anything; others are counted and reported. The one
exception is RADIO_STATUS, which radios cannot sign and which can only slow the downlink down within limits.
"""

import logging
from collections import OrderedDict
from collections.abc import Callable, Mapping
from concurrent.futures import Future, ThreadPoolExecutor
from statistics import fmean
from typing import Any, Protocol

from daq.clock import NS, Clock
from daq.contract.link import commands as c
from daq.contract.link.scan_map import BLOCK
from daq.contract.link.wire import SCAN_FAST_ID
from daq.contract.recordings.messages import Event
from daq.telemetry import gcs_replies
from daq.telemetry.backfill import BackfillServer
from daq.telemetry.downlink import Downlink
from daq.telemetry.flight_state import flight_evidence
from daq.telemetry.log_server import LogServer
from daq.telemetry.send_queue import Item, item
from daq.transport.mavlink_codec import RADIO_STATUS_ID, Frame, FrameDecoder
from daq.transport.ports import BytePort
from daq.transport.signing import Signer, Verdict

_LOG = logging.getLogger("sideslip.uplink")

READ_BYTES = 4096
_MEMORY = 256
_REPEAT_NS = 30 * NS
_REPORT_NS = 5 * NS
_WARNING = 4
_NOTICE = 5
Fields = Mapping[str, Any]

_HARMLESS = ("HEARTBEAT", "TIMESYNC", "RADIO_STATUS")


class LoggerControl(Protocol):
    """What commands can do to the logger; calls return at once."""

    def start_recording(self) -> bool:
        """Begin to record; False when it does already or cannot."""
        ...

    def stop_recording(self) -> bool:
        """End the recording; False when there is none."""
        ...

    @property
    def recording(self) -> bool:
        """Whether a recording is under way."""
        ...

    def mark_event(self, text: str, origin: str) -> Event:
        """Record an event at the present scan."""
        ...


class Uplink:
    """Reads a link's port and acts on what the ground may ask."""

    def __init__(
        self,
        port: BytePort,
        clock: Clock,
        downlink: Downlink,
        *,
        signer: Signer | None = None,
        backfill: BackfillServer | None = None,
        logs: LogServer | None = None,
    ) -> None:
        self._port = port
        self._clock = clock
        self._downlink = downlink
        self._signer = signer
        self._backfill = backfill
        self._logs = logs
        self._servers = tuple(server for server in (backfill, logs) if server is not None)
        self._decoder = FrameDecoder()
        self._done: OrderedDict[tuple[Any, ...], tuple[int, int]] = OrderedDict()  # command -> time, result
        self._reported_ns: int | None = None
        self._unreported = 0
        self._refusal = ""
        self._saver: Future[None] | None = None
        self._worker: ThreadPoolExecutor | None = None
        downlink.outbox.bulk = self._next_bulk
        self._handlers: Mapping[str, Callable[[Fields, int], None]] = {
            "RADIO_STATUS": self._on_radio_status,
            "TIMESYNC": self._on_timesync,
            "SENT_MAP_REQUEST": self._on_sent_map_request,
            "BACKFILL_REQUEST": self._on_backfill_request,
            "BACKFILL_SUMMARY_REQUEST": self._on_backfill_summary_request,
            "LOG_REQUEST_LIST": self._on_log_request_list,
            "LOG_REQUEST_DATA": self._on_log_request_data,
            "LOG_REQUEST_END": self._on_log_request_end,
            "LOG_ERASE": self._on_log_erase,
        }

    def _next_bulk(self) -> Item | None:
        for server in self._servers:
            if server.busy and (made := server.next_item()) is not None:
                return made
        return None

    def service(self, now_ns: int, control: LoggerControl) -> None:
        """Act on what has arrived."""
        data = self._port.read(READ_BYTES)
        if data:
            for found in self._decoder.feed(data):
                if isinstance(found, Frame) and found.known:
                    self._take(found, now_ns, control)
        if self._unreported:
            self._report_refusals(now_ns)
        if self._signer is not None and self._signer.needs_saving():
            self._save_signing(self._signer)

    def close(self) -> None:
        """End the worker threads and save the signing timestamps."""
        if self._worker is not None:
            self._worker.shutdown(wait=True)
            self._worker = None
        if self._signer is not None:
            try:
                self._signer.save()
            except OSError as error:
                _LOG.error("signing timestamps not saved: %s", error)
        if self._logs is not None:
            self._logs.close()

    def _save_signing(self, signer: Signer) -> None:
        """Save signing timestamps in a thread, for the card may be slow, one save at a time."""
        if self._saver is not None:
            if not self._saver.done():
                return
            error = self._saver.exception()
            if error is not None:
                _LOG.error("signing timestamps not saved: %s", error)
        if self._worker is None:
            self._worker = ThreadPoolExecutor(1, thread_name_prefix="uplink-signing")
        self._saver = self._worker.submit(signer.save)

    def _take(self, frame: Frame, now_ns: int, control: LoggerControl) -> None:
        if frame.system == self._downlink.config.system_id and frame.component == self._downlink.config.component_id:
            return  # our own words come back: an echoing line
        if self._signer is not None and frame.msg_id != RADIO_STATUS_ID:
            verdict = self._signer.judge(frame.signed_part, (frame.system, frame.component), frame.signature)
            if not verdict.accepted:
                self._refuse(frame, verdict)
                return
        fields = frame.fields()
        target = fields.get("target_system", 0)
        if target not in (0, self._downlink.config.system_id):
            return
        if frame.name == "COMMAND_LONG":
            self._command(frame, fields, now_ns, control)
            return
        if frame.name in gcs_replies.REQUESTS:
            made = gcs_replies.answer(
                frame.name, fields, (frame.system, frame.component), lambda: self._downlink.config.rate_hz
            )
            if made is not None:
                self._downlink.outbox.put_low(made)
            return
        handler = self._handlers.get(frame.name)
        if handler is not None:
            handler(fields, now_ns)

    def _refuse(self, frame: Frame, verdict: Verdict) -> None:
        self._downlink.refusals.rejected_frames += 1
        if frame.name in _HARMLESS and verdict is Verdict.UNSIGNED:
            return
        self._unreported += 1
        self._refusal = f"refused {frame.name} from {frame.system}/{frame.component}: {verdict.value}"

    def _report_refusals(self, now_ns: int) -> None:
        """Tell of refusals, at most every five seconds, all of them in time."""
        if self._reported_ns is not None and now_ns - self._reported_ns < _REPORT_NS:
            return
        words = self._refusal + (f" (and {self._unreported - 1} more)" if self._unreported > 1 else "")
        _LOG.warning("%s", words)
        self._downlink.text(_WARNING, words)
        self._reported_ns, self._unreported = now_ns, 0

    # ----------------------------------------------------------------------------------------- messages

    def _on_radio_status(self, fields: Fields, now_ns: int) -> None:
        self._downlink.radio_status(min(100, fields["txbuf"]), now_ns)

    def _on_timesync(self, fields: Fields, now_ns: int) -> None:
        if fields["tc1"] == 0:
            now = self._clock.monotonic_ns()
            self._downlink.outbox.put_urgent(item("TIMESYNC", tc1=now, ts1=fields["ts1"]))

    def _on_sent_map_request(self, fields: Fields, now_ns: int) -> None:
        if fields["boot"] == self._downlink.boot:
            self._downlink.outbox.put_low(self._downlink.sent_map(fields["first_number"] // BLOCK))

    def _on_backfill_request(self, fields: Fields, now_ns: int) -> None:
        if self._backfill is not None and fields["boot"] == self._downlink.boot:
            self._backfill.request(fields["first_number"], fields["wanted"], fields["fragments"])

    def _on_backfill_summary_request(self, fields: Fields, now_ns: int) -> None:
        if self._backfill is not None and fields["boot"] in (0, self._downlink.boot):
            self._downlink.outbox.put_low(self._backfill.summary(fields["through_number"]))
            self._downlink.outbox.put_low(self._downlink.statistics())

    def _on_log_request_list(self, fields: Fields, now_ns: int) -> None:
        if self._logs is not None:
            self._logs.request_list(fields["start"], fields["end"])

    def _on_log_request_data(self, fields: Fields, now_ns: int) -> None:
        if self._logs is not None:
            self._logs.request_data(fields["id"], fields["ofs"], fields["count"])

    def _on_log_request_end(self, fields: Fields, now_ns: int) -> None:
        if self._logs is not None:
            self._logs.request_end()

    def _on_log_erase(self, fields: Fields, now_ns: int) -> None:
        self._downlink.text(_WARNING, "LOG_ERASE refused: recordings are not erased from the ground")

    # ----------------------------------------------------------------------------------------- commands

    def _command(self, frame: Frame, fields: Fields, now_ns: int, control: LoggerControl) -> None:
        command = int(fields["command"])
        parameters = tuple(float(fields[f"param{i}"]) for i in range(1, 8))
        key = (frame.system, frame.component, command, *(p.hex() for p in parameters))
        known = self._done.get(key)
        # The same request again, its acknowledgement lost: the answer is repeated, the action is not.
        repeated = fields["confirmation"] > 0 or command == c.EVENT_MARK
        if known is not None and repeated and now_ns - known[0] < _REPEAT_NS:
            result = known[1]
        else:
            result = self._obey(command, parameters, control)
            self._done[key] = (now_ns, result)
            if len(self._done) > _MEMORY:
                self._done.popitem(last=False)
            if result not in (c.ACCEPTED, c.UNSUPPORTED):
                self._downlink.refusals.rejected_commands += 1
        ack = item(
            "COMMAND_ACK",
            command=command,
            result=result,
            target_system=frame.system,
            target_component=frame.component,
        )
        self._downlink.outbox.put_urgent(ack)

    def _obey(self, command: int, parameters: tuple[float, ...], control: LoggerControl) -> int:
        match command:
            case c.LOGGING_START:
                if not control.start_recording() and not control.recording:
                    return c.FAILED
            case c.LOGGING_STOP:
                control.stop_recording()
            case c.EVENT_MARK:
                control.mark_event(f"mark {_whole(parameters[0])}", "ground")
            case c.SET_MESSAGE_INTERVAL:
                return self._set_rate(parameters)
            case c.PREFLIGHT_CALIBRATION:
                return self._zero_pitot(parameters, control)
            case _:
                return c.UNSUPPORTED
        return c.ACCEPTED

    def _set_rate(self, parameters: tuple[float, ...]) -> int:
        if parameters[0] != SCAN_FAST_ID:
            return c.UNSUPPORTED
        interval = parameters[1]
        rate = self._downlink.config.rate_hz if interval == 0 else 1e6 / interval if interval > 0 else 0.0
        if not self._downlink.set_rate(rate):
            self._downlink.text(_WARNING, f"downlink rate {rate:.1f} Hz refused: outside 2 Hz to the byte budget")
            return c.DENIED
        return c.ACCEPTED

    def _zero_pitot(self, parameters: tuple[float, ...], control: LoggerControl) -> int:
        others = [p for i, p in enumerate(parameters[:6]) if i != c.AIRSPEED_PARAMETER - 1]
        if parameters[c.AIRSPEED_PARAMETER - 1] != c.AIRSPEED_CALIBRATION or any(others):
            return c.UNSUPPORTED
        scans = list(self._downlink.recent)
        evidence = flight_evidence(scans)
        if evidence is not None:
            self._downlink.text(_WARNING, f"pitot not zeroed: {evidence}")
            return c.TEMPORARILY_REJECTED
        counts = [s.values["pitot_pressure"] for s in scans if "pitot_pressure" in s.values]
        control.mark_event(c.pitot_zero_text(fmean(counts), len(counts)), "ground")
        self._downlink.text(_NOTICE, f"pitot zeroed at {fmean(counts):.1f} counts")
        return c.ACCEPTED


def _whole(value: float) -> str:
    return str(int(value)) if value.is_integer() else repr(value)
