"""The section [sequencer]: off by default, every mistake named."""

import tomllib
from pathlib import Path
from typing import Any

import pytest

from daq.actuation.autopilot.link import AutopilotError
from daq.actuation.config import HeartbeatConfig
from daq.actuation.pwm.heartbeat import FileHeartbeat, HeartbeatError
from daq.assembly import HardwareEdge, assemble
from daq.clock import SimulatedClock
from daq.config import ConfigError, LoggerConfig, parse_config
from firmware_sim.tables import toml_text
from tests.support.paths import ROOT

CONFIGS = ROOT / "daq" / "configs"


def table() -> dict[str, Any]:
    base = tomllib.loads((CONFIGS / "cdfp.toml").read_text())
    more = tomllib.loads((CONFIGS / "cdfp_sequencer.toml").read_text())
    base["scan"].update(more["scan"])
    base["sequencer"] = more["sequencer"]
    return base


def read(changed: dict[str, Any]) -> LoggerConfig:
    return parse_config(toml_text(changed), Path("/etc/sideslip/aircraft.toml"))


def test_off_by_default_and_the_shipped_section_is_accepted() -> None:
    assert parse_config((CONFIGS / "cdfp.toml").read_text(), CONFIGS / "cdfp.toml").sequencer is None
    config = read(table())
    assert config.sequencer is not None
    assert config.sequencer.manoeuvre == Path("/etc/sideslip/manoeuvre.toml")
    assert config.together == 1


@pytest.mark.parametrize(
    ("path", "value", "words"),
    [
        (("scan", "rate_hz"), 20.0, "set scan.rate_hz"),
        (("sequencer", "chip", "address"), 0x40, "share the I2C address 0x40"),
        (("sequencer", "pilot", "address"), 0x41, "share the I2C address 0x41"),
        (("sequencer", "limits", "height_m"), [50.0, 20.0], r"must be \[lowest, highest\]"),
        (("sequencer", "limits", "stale_ms"), 500.0, "less than or equal to 100"),
        (("sequencer", "output", "rudder", "channel"), 3, "chip channel is used twice"),
        (("sequencer", "output", "rudder", "us_per_rad"), {"delta_r": 0.0}, "no control moves this output"),
        (("sequencer", "output", "rudder", "pilot_input"), 5, "pilot input is used twice"),
        (("sequencer", "output"), {}, "names no servo"),
        (("sequencer", "ramp"), 1.0, "sequencer.ramp is not known"),
        (("sequencer", "start"), "timer", "'switch' or 'ground'"),
    ],
)
def test_mistakes_are_named(path: tuple[str, ...], value: object, words: str) -> None:
    changed = table()
    place = changed
    for key in path[:-1]:
        place = place[key]
    place[path[-1]] = value
    with pytest.raises(ConfigError, match=words):
        read(changed)


def through_an_autopilot() -> dict[str, Any]:
    base = tomllib.loads((CONFIGS / "cdfp.toml").read_text())
    more = tomllib.loads((CONFIGS / "cdfp_sequencer_ardupilot.toml").read_text())
    return {**base, **more}


def test_the_section_through_an_autopilot_is_accepted() -> None:
    config = read(through_an_autopilot())
    assert config.sequencer is not None
    assert config.sequencer.through == "ardupilot"


@pytest.mark.parametrize(
    ("path", "value", "words"),
    [
        (("through",), "px4", "PX4 takes either the sticks or MANUAL_CONTROL"),
        (("autopilot", "port"), "", r"autopilot\.port is missing"),
        (("autopilot", "longest_override_s"), 3.0, "less than or equal to 0.3"),
        (("autopilot", "watch"), [3, 4], "channel of the receiver is used twice"),
        (("output", "yaw", "channel"), 9, "channel 9 cannot be released by 0; use 1 to 8"),
        (("output", "yaw", "readback"), 3, "leave pilot_input and readback out"),
        (("output", "yaw", "channel"), 5, "channel of the receiver is used twice"),
    ],
)
def test_mistakes_through_an_autopilot_are_named(path: tuple[str, ...], value: object, words: str) -> None:
    changed = through_an_autopilot()
    place = changed["sequencer"]
    for key in path[:-1]:
        place = place[key]
    place[path[-1]] = value
    with pytest.raises(ConfigError, match=words):
        read(changed)


def test_one_port_is_not_read_twice() -> None:
    changed = through_an_autopilot()
    changed["sensors"]["capture"] = {"driver": "mavlink_servo", "device": "/dev/ttyAMA2"}
    with pytest.raises(ConfigError, match=r"both read /dev/ttyAMA2; give the sequencer a port of its own"):
        read(changed)


def test_without_a_port_to_the_autopilot_nothing_is_assembled() -> None:
    with pytest.raises(AutopilotError, match="no port to it is open"):
        assemble(read(through_an_autopilot()), "", HardwareEdge(SimulatedClock(), None, None, "simulated"))


def test_an_output_without_the_pilots_signal_is_named() -> None:
    changed = table()
    del changed["sequencer"]["output"]["rudder"]["pilot_input"]
    with pytest.raises(ConfigError, match="output rudder: pilot_input is missing"):
        read(changed)


def test_what_is_watched_must_be_fitted() -> None:
    changed = table()
    del changed["sensors"]["gnss"]
    with pytest.raises(ConfigError, match="sequencer watches gnss, not fitted"):
        read(changed)


@pytest.mark.parametrize(
    ("model", "name", "known"),
    [
        ("", "Cl_p", True),
        ("", "Clp", False),
        ("lateral", "CL_alpha", False),
        ("longitudinal", "Cl_p", False),
        ("six-dof", "Cm_q", True),
        ("six-dof", "Cm_0", False),  # nobody flies for a constant
        ("own.toml", "Foo", True),  # what it estimates is known once it is read
    ],
)
def test_until_names_what_is_estimated_on_board(model: str, name: str, known: bool) -> None:
    changed = table()
    changed["sequencer"]["until"] = f"{name} 5 %"
    changed["identification"] = {"model": model}
    if known:
        assert read(changed).sequencer is not None
        return
    with pytest.raises(ConfigError, match=f"does not estimate {name}; name one of C[YL]_"):
        read(changed)


def test_without_a_heartbeat_line_nothing_is_assembled(tmp_path: Path) -> None:
    config = read(table())
    with pytest.raises(HeartbeatError, match="heartbeat line"):
        assemble(config, "", HardwareEdge(SimulatedClock(), None, None, "simulated"))


class TestHeartbeatFile:
    def test_edges_and_release(self, tmp_path: Path) -> None:
        line, clear = tmp_path / "line", tmp_path / "clear"
        line.touch()
        clear.touch()
        heartbeat = FileHeartbeat(HeartbeatConfig(line=line, clear=clear))
        heartbeat.beat()
        heartbeat.beat()
        heartbeat.close()
        assert line.read_bytes() == b"1010"
        assert clear.read_bytes() == b"01" + b"1" + b"0"

    def test_a_line_that_the_kernel_drives_by_itself_is_refused(self, tmp_path: Path) -> None:
        (tmp_path / "brightness").touch()
        (tmp_path / "trigger").write_text("none timer [heartbeat]")
        with pytest.raises(HeartbeatError, match="write none into it"):
            FileHeartbeat(HeartbeatConfig(line=tmp_path / "brightness", clear=None))

    def test_an_absent_line(self, tmp_path: Path) -> None:
        with pytest.raises(HeartbeatError, match=r"set sequencer\.heartbeat"):
            FileHeartbeat(HeartbeatConfig(line=tmp_path / "nowhere" / "brightness", clear=None))
