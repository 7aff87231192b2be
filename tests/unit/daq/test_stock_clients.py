"""A stock pymavlink client sees the aircraft and fetches a recording over loopback, knowing nothing of this project."""

import math
import time
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from daq.clock import SimulatedClock
from daq.telemetry.config import DownlinkConfig
from daq.telemetry.link import RadioLink, radio_link
from daq.transport.ports import UdpPort
from tests.support.free_ports import free_port
from tests.support.link_rig import PERIOD_NS, START_UTC_NS, FakeLogger, quiet_scan


class Session:
    """An aircraft sending to a stock client, in simulated time.

    A client that began in MAVLink 1 changes over, with another `client.mav`, at the first frame it hears; the aircraft takes
    none in MAVLink 1. Nothing is therefore asked before something was heard.
    """

    def __init__(self, folder: Path) -> None:
        from pymavlink import mavutil

        number = free_port()
        self.client: Any = mavutil.mavlink_connection(f"udpin:127.0.0.1:{number}", source_system=255)
        self.clock = SimulatedClock(START_UTC_NS)
        self.logger = FakeLogger()
        port = UdpPort(remote=("127.0.0.1", number))
        config = DownlinkConfig(budget_bytes_per_s=60_000)
        self.link: RadioLink = radio_link(config, port, self.clock, recordings=(folder,), boot=3)
        self._rng = np.random.default_rng(2)
        self._number = 0
        self.seen: list[Any] = []

    def found(self, kind: str) -> Any:
        """The latest message of a kind that has come, or the next one."""
        return next((m for m in reversed(self.seen) if m.get_type() == kind), None) or self.until(kind)

    def step(self) -> list[Any]:
        """One scan; what the client then has."""
        self.clock.advance(PERIOD_NS)
        now = self.clock.monotonic_ns()
        self.link.offer(quiet_scan(self._number, self._rng, time_ns=now))
        self._number += 1
        self.link.uplink.service(now, self.logger)
        self.link.service(now)
        out = []
        while (message := self.client.recv_match()) is not None:
            out.append(message)
        self.seen += out
        return out

    def until(self, kind: str, steps: int = 400) -> Any:
        """Step until a message of a kind comes."""
        for _ in range(steps):
            for message in self.step():
                if message.get_type() == kind:
                    return message
            time.sleep(0.001)  # files are read by a thread of the server
        raise AssertionError(f"no {kind} in {steps} scans")

    def collect(self, kind: str, count: int) -> list[Any]:
        """Step until so many messages of a kind have come."""
        found: list[Any] = []
        for _ in range(400):
            found += [m for m in self.step() if m.get_type() == kind]
            if len(found) >= count:
                return found
            time.sleep(0.001)
        raise AssertionError(f"{len(found)} {kind}, not {count}")

    def close(self) -> None:
        self.link.close()
        self.client.close()


@pytest.fixture
def session(tmp_path: Path) -> Iterator[Session]:
    made = Session(tmp_path)
    yield made
    made.close()


def test_heartbeat_attitude_gps_and_texts(session: Session) -> None:
    beat = session.until("HEARTBEAT")
    assert (beat.get_srcSystem(), beat.type, beat.system_status) == (1, 1, 3)
    assert beat.autopilot == 8, "no autopilot"
    attitude = session.until("ATTITUDE")
    assert (attitude.roll, attitude.pitch, attitude.yaw) == pytest.approx((0, 0, 0), abs=1e-6)
    gps = session.until("GPS_RAW_INT")
    assert (gps.lat, gps.lon, gps.alt, gps.fix_type) == (473977420, 85455940, 488000, 3)
    status = session.until("SYS_STATUS")
    assert status.onboard_control_sensors_present & 32
    session.link.text(4, "low airspeed")
    text = session.until("STATUSTEXT")
    assert (text.severity, text.text) == (4, "low airspeed")


def test_stock_client_downloads_a_recording(session: Session, tmp_path: Path) -> None:
    rng = np.random.default_rng(1)
    content = rng.integers(0, 256, 20_000, dtype=np.uint8).tobytes()
    (tmp_path / "session_000.mcap").write_bytes(b"older")
    (tmp_path / "session_001.mcap").write_bytes(content)
    session.until("HEARTBEAT")
    session.client.mav.log_request_list_send(1, 1, 0, 0xFFFF)
    entries = session.collect("LOG_ENTRY", 2)
    assert [(e.id, e.num_logs, e.size) for e in entries] == [(1, 2, 5), (2, 2, 20_000)]
    session.client.mav.log_request_data_send(1, 1, 2, 0, 0xFFFFFFFF)
    got = bytearray(len(content))
    seen = 0
    for _ in range(2000):
        for message in session.step():
            if message.get_type() == "LOG_DATA":
                got[message.ofs : message.ofs + message.count] = bytes(message.data[: message.count])
                seen += message.count
        if seen >= len(content):
            break
        time.sleep(0.001)
    assert bytes(got) == content


def test_stock_client_asks_for_one_piece_again(session: Session, tmp_path: Path) -> None:
    (tmp_path / "a.mcap").write_bytes(bytes(range(200)))
    session.until("HEARTBEAT")
    session.client.mav.log_request_list_send(1, 1, 0, 0xFFFF)
    session.until("LOG_ENTRY")
    session.client.mav.log_request_data_send(1, 1, 1, 90, 90)
    piece = session.until("LOG_DATA")
    assert (piece.ofs, piece.count, bytes(piece.data)) == (90, 90, bytes(range(90, 180)))
    session.client.mav.log_request_data_send(1, 1, 77, 0, 90)
    end = session.until("LOG_DATA")
    assert (end.id, end.count) == (77, 0)
    session.client.mav.log_erase_send(1, 1)
    assert "refused" in session.until("STATUSTEXT").text
    assert (tmp_path / "a.mcap").exists()


def test_stock_commands_are_acknowledged(session: Session) -> None:
    from pymavlink import mavutil

    m = mavutil.mavlink
    session.until("HEARTBEAT")
    session.client.mav.command_long_send(1, 1, m.MAV_CMD_LOGGING_STOP, 0, 0, 0, 0, 0, 0, 0, 0)
    ack = session.until("COMMAND_ACK")
    assert (ack.command, ack.result) == (m.MAV_CMD_LOGGING_STOP, m.MAV_RESULT_ACCEPTED)
    assert session.logger.stops == 1


def test_messages_asked_for_come_and_others_are_refused(session: Session) -> None:
    from pymavlink import mavutil

    m = mavutil.mavlink

    def ask(command: int, parameter: float) -> int:
        session.client.mav.command_long_send(1, 1, command, 0, parameter, 0, 0, 0, 0, 0, 0)
        ack = session.until("COMMAND_ACK")
        assert ack.command == command
        return int(ack.result)

    session.until("SYS_STATUS")
    assert ask(m.MAV_CMD_REQUEST_MESSAGE, 148) == m.MAV_RESULT_ACCEPTED
    assert session.found("AUTOPILOT_VERSION").capabilities & m.MAV_PROTOCOL_CAPABILITY_MAVLINK2
    assert ask(m.MAV_CMD_GET_HOME_POSITION, 0) == m.MAV_RESULT_ACCEPTED
    assert session.found("HOME_POSITION").altitude == 488_000
    # COMPONENT_METADATA, AVAILABLE_MODES, PROTOCOL_VERSION, CAMERA_INFORMATION, GIMBAL_MANAGER_INFORMATION, no message
    for number in (397, 435, 300, 259, 280, 1.5, math.nan, 1e30):
        assert ask(m.MAV_CMD_REQUEST_MESSAGE, number) == m.MAV_RESULT_UNSUPPORTED
    # WIND_COV, which cannot be known here
    assert ask(m.MAV_CMD_REQUEST_MESSAGE, 231) == m.MAV_RESULT_TEMPORARILY_REJECTED
    assert session.link.downlink.rejected_commands == 0


def test_missions_files_and_unknown_parameters_are_refused_in_words_of_the_protocol(session: Session) -> None:
    from pymavlink import mavutil

    session.until("HEARTBEAT")
    m, ask = mavutil.mavlink, session.client.mav
    ask.mission_count_send(1, 1, 3, 1)
    refused = session.until("MISSION_ACK")
    assert (refused.type, refused.mission_type, refused.target_system) == (m.MAV_MISSION_UNSUPPORTED, 1, 255)
    ask.mission_request_int_send(1, 1, 0)
    assert session.until("MISSION_ACK").type == m.MAV_MISSION_INVALID_SEQUENCE
    ask.mission_clear_all_send(1, 1)
    assert session.until("MISSION_ACK").type == m.MAV_MISSION_ACCEPTED
    ask.param_request_read_send(1, 1, b"SYSID_THISMAV", -1)
    error = session.until("PARAM_ERROR")
    assert (error.param_id, error.error) == ("SYSID_THISMAV", m.MAV_PARAM_ERROR_DOES_NOT_EXIST)
    ask.param_request_read_send(1, 1, b"", 5)
    assert session.until("PARAM_ERROR").param_index == 5
    ask.param_set_send(1, 1, b"DOWNLINK_RATE", 3.0, m.MAV_PARAM_TYPE_REAL32)
    assert session.until("PARAM_ERROR").error == m.MAV_PARAM_ERROR_READ_ONLY


@pytest.mark.parametrize(
    ("opcode", "reply", "data"),
    [(4, 129, [10]), (3, 129, [6]), (16, 129, [7]), (6, 129, [7]), (1, 128, []), (2, 128, [])],
)
def test_files_are_refused_at_once(session: Session, opcode: int, reply: int, data: list[int]) -> None:
    """Opcodes: open, list, list with times, create, end a session, end all; replies ACK and NAK with the error's number."""
    session.until("HEARTBEAT")
    asked = [0xFF, 0xFF, 7, opcode, 5, 0, 0, 0, 0, 0, 0, 0, *b"a.txt"]
    session.client.mav.file_transfer_protocol_send(0, 1, 1, asked + [0] * (251 - len(asked)))
    answer = session.until("FILE_TRANSFER_PROTOCOL")
    payload = list(answer.payload)
    assert answer.target_system == 255
    assert payload[:2] == [0, 0], "the next sequence number, which wraps"
    assert payload[2:6] == [7, reply, len(data), opcode]
    assert payload[12 : 12 + len(data)] == data


def test_an_answer_about_files_is_not_answered(session: Session) -> None:
    session.until("HEARTBEAT")
    for opcode in (128, 129):
        session.client.mav.file_transfer_protocol_send(0, 1, 1, [0, 0, 0, opcode] + [0] * 247)
    heard = [message.get_type() for _ in range(30) for message in session.step()]
    assert "FILE_TRANSFER_PROTOCOL" not in heard


def test_a_station_that_asks_nobody_in_particular_is_told_who_is_here_and_seldom(session: Session) -> None:
    session.until("HEARTBEAT")
    for _ in range(5):
        session.client.mav.param_request_list_send(0, 0)
        session.until("PARAM_VALUE")
    heard = [message for _ in range(40) for message in session.step()]
    told = [m for m in (*session.seen, *heard) if m.get_type() == "HIGH_LATENCY2"]
    assert len(told) == 1
    assert (told[0].type, told[0].get_srcSystem(), told[0].altitude) == (1, 1, 488)
    session.client.mav.param_request_list_send(1, 1)
    heard = [message.get_type() for _ in range(120) for message in session.step()]
    assert "HIGH_LATENCY2" not in heard


def test_a_general_ground_station_is_not_left_waiting(session: Session) -> None:
    from pymavlink import mavutil

    session.until("HEARTBEAT")
    m, ask = mavutil.mavlink, session.client.mav
    ask.param_request_list_send(1, 1)
    value = session.until("PARAM_VALUE")
    assert (value.param_id, value.param_value, value.param_count) == ("DOWNLINK_RATE", 11.5, 1)
    ask.param_set_send(1, 1, b"DOWNLINK_RATE", 3.0, m.MAV_PARAM_TYPE_REAL32)
    assert session.until("PARAM_VALUE").param_value == 11.5
    ask.param_request_read_send(1, 1, b"", 0)
    assert session.until("PARAM_VALUE").param_index == 0
    ask.mission_request_list_send(1, 1, 2)
    mission = session.until("MISSION_COUNT")
    assert (mission.count, mission.mission_type, mission.target_system) == (0, 2, 255)
    ask.command_int_send(1, 1, 0, m.MAV_CMD_DO_REPOSITION, 0, 0, 0, 0, 0, 0, 0, 0, 0)
    assert session.until("COMMAND_ACK").result == m.MAV_RESULT_UNSUPPORTED
    ask.command_int_send(1, 1, 0, m.MAV_CMD_LOGGING_STOP, 0, 0, 0, 0, 0, 0, 0, 0, 0)
    assert session.until("COMMAND_ACK").result == m.MAV_RESULT_COMMAND_LONG_ONLY
    assert session.logger.stops == 0


def test_what_strangers_send_is_refused_or_ignored_and_breaks_nothing(session: Session) -> None:
    from pymavlink import mavutil

    session.until("HEARTBEAT")
    m, ask = mavutil.mavlink, session.client.mav
    unknown = (
        m.MAV_CMD_REQUEST_AUTOPILOT_CAPABILITIES,
        m.MAV_CMD_REQUEST_PROTOCOL_VERSION,
        m.MAV_CMD_GET_MESSAGE_INTERVAL,
        m.MAV_CMD_COMPONENT_ARM_DISARM,
        m.MAV_CMD_DO_SET_MODE,
        m.MAV_CMD_PREFLIGHT_REBOOT_SHUTDOWN,
        65535,
    )
    for command in unknown:
        ask.command_long_send(1, 1, command, 0, 1, 0, 0, 0, 0, 0, 0)
        ack = session.until("COMMAND_ACK")
        assert (ack.command, ack.result) == (command, m.MAV_RESULT_UNSUPPORTED)
    ask.command_long_send(1, 1, m.MAV_CMD_SET_MESSAGE_INTERVAL, 0, 30, 1e5, 0, 0, 0, 0, 0)  # ATTITUDE has its rate
    assert session.until("COMMAND_ACK").result == m.MAV_RESULT_UNSUPPORTED
    ask.command_long_send(77, 1, m.MAV_CMD_LOGGING_STOP, 0, 0, 0, 0, 0, 0, 0, 0)  # to another aircraft
    ask.request_data_stream_send(1, 1, 0, 4, 1)
    ask.file_transfer_protocol_send(0, 1, 1, [0] * 251)
    ask.manual_control_send(1, 0, 0, 0, 0, 0)
    ask.set_mode_send(1, 1, 0)
    ask.statustext_send(6, b"hello")
    ask.param_request_read_send(1, 1, b"SYSID_THISMAV", -1)
    ask.param_request_read_send(1, 1, b"", 5)
    heard = [message.get_type() for _ in range(60) for message in session.step()]
    assert heard.count("HEARTBEAT") >= 2
    assert not {"PARAM_VALUE", "COMMAND_ACK"} & set(heard)
    assert session.logger.recording
