"""Commands and requests from the ground: checked, executed once, answered again when repeated.

With a signing key only frames with a valid signature have an effect; others are counted and reported. The one exception is
RADIO_STATUS, which radios cannot sign and which can only slow the downlink down within limits.

A turn takes at most a few milliseconds of the scan loop, whatever arrives: bytes and frames per turn are limited, and the rest
waits for the next turn. Requests per sender and commands that write to the card are limited too (`request_limits`).
"""

import logging
from collections import OrderedDict, deque
from collections.abc import Callable, Iterator, Mapping
from concurrent.futures import Future
from statistics import fmean
from typing import Any

from daq.clock import NS, Clock
from daq.contract.link import commands as c
from daq.contract.link.scan_map import BLOCK
from daq.contract.link.wire import SCAN_FAST_ID
from daq.telemetry import gcs_replies
from daq.telemetry.backfill import BackfillServer
from daq.telemetry.control import Control
from daq.telemetry.downlink import Downlink
from daq.telemetry.log_server import LogServer
from daq.telemetry.manoeuvre_inbox import ManoeuvreInbox
from daq.telemetry.request_limits import REPORT_NS, CommandBudget, Refusals, SenderLimits, flight_evidence
from daq.telemetry.send_queue import Item, item
from daq.telemetry.standard_messages import autopilot_version
from daq.telemetry.worker import Worker
from daq.transport.mavlink_codec import RADIO_STATUS_ID, FrameDecoder, MavlinkFrame
from daq.transport.ports import BytePort
from daq.transport.signing import SignatureVerdict, Signer

_LOG = logging.getLogger("sideslip.uplink")

READ_BYTES = 4096
"""Bytes read in a turn: at ten turns a second seven times what a radio at 57600 baud delivers. Noise that is hard to decode
costs 0.25 us a byte on a 2020s x86 core and five times that on a small ARM core: 1 to 5 ms a turn."""
_READ_CHUNK_BYTES = 512  # the clock is read between two chunks
TURN_NS = 5_000_000
"""Longest turn: a tenth of the time between two scans at 20 Hz."""
FRAMES_PER_TURN = 128
"""Frames processed in a turn: twenty times what a ground station sends in one; each costs some 10 us."""
_REMEMBERED_COMMANDS = 256  # more than a ground station sends within _REPEAT_NS
_REPEAT_NS = 30 * NS  # a command sent again within this is answered from memory
_NOTICE, _WARNING = 5, 4  # severities of STATUSTEXT, as syslog has them
_CLOSE_TIMEOUT_S = 2.0  # for a save of the signing timestamps that is running when the link is closed
Fields = Mapping[str, Any]

_HARMLESS = ("HEARTBEAT", "TIMESYNC", "RADIO_STATUS")  # counted, but not reported, where they lack a signature
_BUSY = "too much is under way"
_BROADCAST_REQUESTS = ("COMMAND_LONG", "PARAM_REQUEST_LIST", "FILE_TRANSFER_PROTOCOL", "LOG_REQUEST_LIST")
_INTRODUCE_NS = 5 * NS  # between two summaries for stations that broadcast requests
_UNLIMITED = ("HEARTBEAT", "RADIO_STATUS")  # not answered, and cheap


class Uplink:
    """Reads a link's port and executes commands and requests.

    turn_ns: longest turn [ns]. dropped: returns how many datagrams the port has dropped so far.
    """

    def __init__(
        self,
        port: BytePort,
        clock: Clock,
        downlink: Downlink,
        *,
        signer: Signer | None = None,
        backfill: BackfillServer | None = None,
        logs: LogServer | None = None,
        turn_ns: int = TURN_NS,
        dropped: Callable[[], int] = lambda: 0,
    ) -> None:
        self._port = port
        self._clock = clock
        self._downlink = downlink
        self._signer = signer
        self._backfill = backfill
        self._logs = logs
        self._servers = deque(server for server in (backfill, logs) if server is not None)
        self._decoder = FrameDecoder()
        self._frames: deque[MavlinkFrame] = deque()  # decoded, not processed yet
        self._turn_ns = turn_ns
        self._limits = SenderLimits(downlink.config.limits.requests_per_s)
        self._budget = CommandBudget(downlink.config.limits)
        self._refusals = Refusals(downlink.text)
        self._dropped = dropped
        self._dropped_reported = 0
        self._dropped_checked_ns = 0
        self._introduced_ns: int | None = None
        self._command_results: OrderedDict[tuple[Any, ...], tuple[int, int]] = OrderedDict()  # command -> time, result
        self._saver: Future[None] | None = None
        self._last_frame_ns: int | None = None  # when the last accepted frame of the ground came
        self._worker = Worker("uplink-signing")
        self._manoeuvres = ManoeuvreInbox(downlink.text)
        downlink.send_queue.bulk = self._next_bulk_message

    def _next_bulk_message(self) -> Item | None:
        """The next message of backfill or log download, which alternate; None without one."""
        for _ in range(len(self._servers)):
            server = self._servers[0]
            self._servers.rotate(-1)
            if server.busy and (message := server.next_item()) is not None:
                return message
        return None

    def service(self, now_ns: int, control: Control) -> None:
        """Process what has arrived, within the limits of a turn, and send what is due."""
        until_ns = self._clock.monotonic_ns() + self._turn_ns
        for _, frame in zip(range(FRAMES_PER_TURN), self._pending_frames(until_ns), strict=False):
            self._receive(frame, now_ns, control)
            if self._clock.monotonic_ns() >= until_ns:
                break
        if now_ns - self._dropped_checked_ns >= REPORT_NS:
            self._dropped_checked_ns = now_ns
            self._note_dropped()
        self._refusals.report(now_ns)
        self._answer(self._manoeuvres.service(control))
        if self._signer is not None and self._signer.needs_saving():
            self._save_signing(self._signer)

    def _pending_frames(self, until_ns: int) -> Iterator[MavlinkFrame]:
        """Frames left from the last turn, then those read in this one; ends at READ_BYTES or at `until_ns`."""
        bytes_left = READ_BYTES
        while True:
            while self._frames:
                yield self._frames.popleft()
            if bytes_left <= 0 or self._clock.monotonic_ns() >= until_ns:
                return
            data = self._port.read(min(bytes_left, _READ_CHUNK_BYTES))
            if not data:
                return
            bytes_left -= len(data)
            self._frames.extend(f for f in self._decoder.feed(data) if isinstance(f, MavlinkFrame) and f.known)

    def _note_dropped(self) -> None:
        total = self._dropped()
        new, self._dropped_reported = total - self._dropped_reported, total
        if new:
            self._refusals.note(f"{new} datagrams dropped unread: too long, or too many to be read")

    def silence_s(self, now_ns: int) -> float | None:
        """Time since the last accepted frame of the ground [s], None without one; RADIO_STATUS does not count."""
        return None if self._last_frame_ns is None else (now_ns - self._last_frame_ns) * 1e-9

    def close(self) -> None:
        """End the worker threads and save the signing timestamps."""
        if not self._worker.close(_CLOSE_TIMEOUT_S):
            _LOG.error("signing timestamps not saved: the card does not answer")
        elif self._signer is not None:
            try:
                self._signer.save()
            except OSError as error:
                _LOG.error("signing timestamps not saved: %s", error)
        for server in self._servers:
            server.close()
        self._manoeuvres.close()

    def _save_signing(self, signer: Signer) -> None:
        """Save the signing timestamps in a thread, for the card may be slow; one save at a time."""
        if self._saver is not None:
            if not self._saver.done():
                return
            error = self._saver.exception()
            if error is not None:
                _LOG.error("signing timestamps not saved: %s", error)
        self._saver = self._worker.submit(signer.save)

    def _receive(self, frame: MavlinkFrame, now_ns: int, control: Control) -> None:
        ours = self._downlink.config
        if frame.system == ours.system_id and frame.component in (ours.component_id, ours.data_component_id):
            return  # our own frame: the line echoes
        if self._signer is not None and frame.msg_id != RADIO_STATUS_ID:
            verdict = self._signer.judge(frame.signed_part, (frame.system, frame.component), frame.signature)
            if not verdict.accepted:
                self._refuse_unsigned(frame, verdict)
                return
        if frame.msg_id != RADIO_STATUS_ID:
            self._last_frame_ns = now_ns
        fields = frame.fields()
        target = fields.get("target_system", 0)
        if target not in (0, self._downlink.config.system_id):
            return
        sender = (frame.system, frame.component)
        if frame.name not in _UNLIMITED and not self._limits.allow(sender, now_ns):
            self._refuse(frame, "too many requests")
            return
        if target == 0 and frame.name in _BROADCAST_REQUESTS:
            self._introduce_self(now_ns)
        if frame.name == "COMMAND_LONG":
            self._command(frame, fields, now_ns, control)
            return
        if frame.name == "MANOEUVRE_DATA":
            self._manoeuvre(frame, fields, control)
            return
        if frame.name in gcs_replies.REQUESTS:
            has_voltage = self._downlink.messages.supply_voltage is not None
            parameters = gcs_replies.parameters(self._downlink.config.rate_hz, has_voltage)
            replies = gcs_replies.answers(frame.name, fields, sender, parameters)
            queued = [self._downlink.send_queue.put_requested(reply) for reply in replies]
            if not all(queued):
                self._refuse(frame, _BUSY)
            return
        if not self._serve(frame.name, fields, now_ns):
            self._refuse(frame, _BUSY)

    def _manoeuvre(self, frame: MavlinkFrame, fields: Fields, control: Control) -> None:
        """A fragment of a manoeuvre; refused without a key, for a manoeuvre moves the controls."""
        if self._signer is None:
            self._refuse(frame, "this link has no key; set downlink.key_file")
            return
        answer = self._manoeuvres.receive(fields, control)
        if answer is None or not self._answer(answer):
            self._refuse(frame, "not a fragment" if answer is None else _BUSY)

    def _answer(self, answer: Item | None) -> bool:
        return answer is None or self._downlink.send_queue.put_requested(answer)

    def _introduce_self(self, now_ns: int) -> None:
        """Send HIGH_LATENCY2 to a station that broadcasts its requests because it has not recognised us as an aircraft.

        MAVProxy is one: it ignores heartbeats that state no autopilot, as ours does, but accepts HIGH_LATENCY2.
        """
        if self._introduced_ns is None or now_ns - self._introduced_ns >= _INTRODUCE_NS:
            self._introduced_ns = now_ns
            summary = self._downlink.messages.make("HIGH_LATENCY2")
            if summary is not None:
                self._downlink.send_queue.put_requested(summary)

    def _refuse_unsigned(self, frame: MavlinkFrame, verdict: SignatureVerdict) -> None:
        if frame.name in _HARMLESS and verdict is SignatureVerdict.UNSIGNED:
            self._downlink.rejected_frames += 1
        else:
            self._refuse(frame, verdict.value)

    def _refuse(self, frame: MavlinkFrame, reason: str) -> None:
        self._downlink.rejected_frames += 1
        self._refusals.note(f"refused {frame.name} from {frame.system}/{frame.component}: {reason}")

    # ----------------------------------------------------------------------------------------- messages

    def _serve(self, name: str, fields: Fields, now_ns: int) -> bool:
        """Process a message that is neither command nor manoeuvre; False when its queue is full."""
        downlink, queue = self._downlink, self._downlink.send_queue
        match name:
            case "RADIO_STATUS":
                downlink.radio_status(min(100, fields["txbuf"]), now_ns)
            case "TIMESYNC" if fields["tc1"] == 0:
                return queue.put_acknowledgement(item("TIMESYNC", tc1=self._clock.monotonic_ns(), ts1=fields["ts1"]))
            case "SENT_MAP_REQUEST" if fields["boot"] == downlink.boot:
                return queue.put_requested(downlink.sent_map(fields["first_number"] // BLOCK))
            case "BACKFILL_REQUEST" if self._backfill is not None and fields["boot"] == downlink.boot:
                return self._backfill.request(fields["first_number"], fields["wanted"], fields["fragments"])
            case "BACKFILL_SUMMARY_REQUEST" if self._backfill is not None and fields["boot"] in (0, downlink.boot):
                summary = self._backfill.summary(fields["through_number"])
                return queue.put_requested(summary) and queue.put_requested(downlink.statistics())
            case "LOG_REQUEST_LIST" if self._logs is not None:
                self._logs.request_list(fields["start"], fields["end"])
            case "LOG_REQUEST_DATA" if self._logs is not None:
                self._logs.request_data(fields["id"], fields["ofs"], fields["count"])
            case "LOG_REQUEST_END" if self._logs is not None:
                self._logs.request_end()
            case "LOG_ERASE":
                self._refusals.note("LOG_ERASE refused: recordings are not erased from the ground")
        return True

    # ----------------------------------------------------------------------------------------- commands

    def _command(self, frame: MavlinkFrame, fields: Fields, now_ns: int, control: Control) -> None:
        command = int(fields["command"])
        parameters = tuple(float(fields[f"param{i}"]) for i in range(1, 8))
        if command in gcs_replies.MESSAGE_COMMANDS:
            self._acknowledge(frame, command, self._send_requested_message(command, parameters[0]))
            return
        key = (frame.system, frame.component, command, *(p.hex() for p in parameters))
        previous = self._command_results.get(key)
        # The sender repeats a command whose acknowledgement was lost: the result is sent again, the action is not repeated.
        repeated = fields["confirmation"] > 0 or command == c.EVENT_MARK
        if previous is not None and repeated and now_ns - previous[0] < _REPEAT_NS:
            result = previous[1]
        else:
            result = self._execute(frame, command, parameters, now_ns, control)
            if result != c.TEMPORARILY_REJECTED:  # the reason may not apply the next time
                self._command_results[key] = (now_ns, result)
            if len(self._command_results) > _REMEMBERED_COMMANDS:
                self._command_results.popitem(last=False)
            if result not in (c.ACCEPTED, c.UNSUPPORTED):
                self._downlink.rejected_commands += 1
        self._acknowledge(frame, command, result)

    def _acknowledge(self, frame: MavlinkFrame, command: int, result: int) -> None:
        ack = item(
            "COMMAND_ACK",
            command=command,
            result=result,
            target_system=frame.system,
            target_component=frame.component,
        )
        if not self._downlink.send_queue.put_acknowledgement(ack):
            self._refuse(frame, _BUSY)

    def _send_requested_message(self, command: int, parameter: float) -> int:
        """Send the message that a command requests; returns the MAV_RESULT. Refusals are not reported otherwise."""
        name = gcs_replies.requested_message(command, parameter)
        if name == "AUTOPILOT_VERSION":
            message: Item | None = autopilot_version()
        elif name is None or name not in self._downlink.messages.names:
            return c.UNSUPPORTED
        else:
            message = self._downlink.messages.make(name)
        if message is None or not self._downlink.send_queue.put_requested(message):
            return c.TEMPORARILY_REJECTED
        return c.ACCEPTED

    def _execute(
        self, frame: MavlinkFrame, command: int, parameters: tuple[float, ...], now_ns: int, control: Control
    ) -> int:
        match command:
            case c.LOGGING_START | c.LOGGING_STOP | c.EVENT_MARK:
                refusal = self._change_recording(command, parameters, now_ns, control)
                if refusal:
                    self._refusals.note(f"refused command {command} from {frame.system}/{frame.component}: {refusal}")
                    return c.TEMPORARILY_REJECTED
                return c.FAILED if command == c.LOGGING_START and not control.recording else c.ACCEPTED
            case c.SET_MESSAGE_INTERVAL:
                return self._set_rate(parameters)
            case c.PREFLIGHT_CALIBRATION:
                return self._zero_pitot(parameters, now_ns, control)
            case c.SEQUENCER:
                return self._sequence(frame, parameters, control)
            case _:
                return c.UNSUPPORTED

    def _change_recording(self, command: int, parameters: tuple[float, ...], now_ns: int, control: Control) -> str:
        """Begin, end or mark the recording. Returns why the budget refuses it, or ""."""
        refusal = ""
        if command == c.EVENT_MARK:
            refusal = self._budget.check_mark(now_ns)
            if not refusal:
                control.mark_event(f"mark {_number_text(parameters[0])}", "ground")
        elif command == c.LOGGING_STOP and control.recording:
            refusal = self._budget.check_stop(now_ns)
            if not refusal:
                control.stop_recording()
        elif command == c.LOGGING_START and not control.recording:
            refusal = self._budget.check_start()
            if not refusal and control.start_recording():
                self._budget.note_start(now_ns)
        return refusal

    def _sequence(self, frame: MavlinkFrame, parameters: tuple[float, ...], control: Control) -> int:
        """Start or stop the sequencer; returns the MAV_RESULT. A start moves the controls, so it needs a link with a key."""
        if parameters[0] not in (0.0, 1.0) or any(parameters[2:]) or not 0.0 <= parameters[1] < 2**24:
            return c.UNSUPPORTED
        start = parameters[0] == 1.0
        if start and self._signer is None:
            self._refusals.note("refused to start the sequencer: this link has no key; set downlink.key_file")
            return c.DENIED
        refusal = control.request_sequencer(int(parameters[1]) if start else None)
        if refusal:
            self._downlink.text(_WARNING, f"sequencer does not {'start' if start else 'stop'}: {refusal}")
            return c.TEMPORARILY_REJECTED
        return c.ACCEPTED

    def _set_rate(self, parameters: tuple[float, ...]) -> int:
        if parameters[0] != SCAN_FAST_ID:
            return c.UNSUPPORTED
        interval = parameters[1]
        rate = self._downlink.config.rate_hz if interval == 0 else 1e6 / interval if interval > 0 else 0.0
        if not self._downlink.set_rate(rate):
            self._refusals.note(f"downlink rate {rate:.1f} Hz refused: outside 2 Hz to the byte budget")
            return c.DENIED
        return c.ACCEPTED

    def _zero_pitot(self, parameters: tuple[float, ...], now_ns: int, control: Control) -> int:
        unused_parameters = [p for i, p in enumerate(parameters[:6]) if i != c.AIRSPEED_PARAMETER - 1]
        if parameters[c.AIRSPEED_PARAMETER - 1] != c.AIRSPEED_CALIBRATION or any(unused_parameters):
            return c.UNSUPPORTED
        scans = list(self._downlink.recent)
        display = self._downlink.messages.display
        evidence = flight_evidence(scans, display.pitot_pascal) or self._budget.check_mark(now_ns)
        if evidence:
            self._refusals.note(f"pitot not zeroed: {evidence}")
            return c.TEMPORARILY_REJECTED
        counts = [s.values["pitot_pressure"] for s in scans if "pitot_pressure" in s.values]
        control.mark_event(c.pitot_zero_text(fmean(counts), len(counts)), "ground")
        display.pitot_zero_count = fmean(counts)
        self._downlink.text(_NOTICE, f"pitot zeroed at {fmean(counts):.1f} counts")
        return c.ACCEPTED


def _number_text(value: float) -> str:
    return str(int(value)) if value.is_integer() else repr(value)
