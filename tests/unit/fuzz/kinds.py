"""The kinds of input: sound ones to begin with, how they are spoilt, and who reads them."""

import contextlib
import math
import sqlite3
import struct
import zlib
from collections.abc import Callable
from dataclasses import dataclass
from functools import cache
from pathlib import Path
from typing import Any

import fastcrc
import numpy as np

import sideslip
from tests.support.paths import ROOT
from tests.unit.fuzz import seeds
from tests.unit.fuzz.mutate import BYTES, TEXT, TOML, Mutator, Rng, flip_bits, mutated

Reader = Callable[[Path, Path], object]
"""Reads a file with a scratch folder at hand; raises what a verb raises."""


@dataclass(frozen=True)
class Kind:
    """One kind of input. suffix: of the file; share: of the cases of a study; readers take turns."""

    name: str
    suffix: str
    inputs: Callable[[], list[bytes]]
    mutators: tuple[Mutator, ...]
    readers: tuple[Reader, ...]
    share: float = 1.0
    quick: int = 25  # cases in the ordinary test run

    def case(self, seed: int, number: int) -> tuple[bytes, Reader]:
        """The spoilt input of that number, and who reads it."""
        rng = np.random.default_rng([seed, zlib.crc32(self.name.encode()), number])
        inputs = _inputs(self.name)
        data = mutated(inputs[int(rng.integers(len(inputs)))], self.mutators, rng)
        return data, self.readers[number % len(self.readers)]


@cache
def _inputs(name: str) -> list[bytes]:
    return KINDS[name].inputs()


# ------------------------------------------------------------------------------------------------- mutators of a format


def new_checksums(data: bytes, rng: Rng) -> bytes:
    """Frames of a telemetry log spoilt inside, with a checksum that holds."""
    from pymavlink.dialects.v20 import ardupilotmega

    out, at = bytearray(data), 0
    while (at := data.find(b"\xfd", at)) >= 0 and at + 12 < len(data):
        end = at + 10 + data[at + 1]
        made = ardupilotmega.mavlink_map.get(int.from_bytes(data[at + 7 : at + 10], "little"))
        if made is not None and end + 2 <= len(data) and rng.random() < 0.3:
            place = int(rng.integers(at + 3, end))
            if not at + 7 <= place < at + 10:
                out[place] = int(rng.integers(256))
            out[end : end + 2] = fastcrc.crc16.mcrf4xx(bytes(out[at + 1 : end]) + bytes([made.crc_extra])).to_bytes(
                2, "little"
            )
        at = end
    return bytes(out)


def lying_format(data: bytes, rng: Rng) -> bytes:
    """A message of a dataflash log described otherwise, with a length that fits the description."""
    heads = [i for i in range(len(data) - 89) if data[i : i + 3] == b"\xa3\x95\x80"]
    if not heads:
        return flip_bits(data, rng)
    at = heads[int(rng.integers(len(heads)))]
    letters = "".join(rng.choice(list("bBhHiIqQfdgMcCeELnNZa"), int(rng.integers(1, 17))))
    labels = ",".join(["TimeUS", *(rng.choice(["I", "x", "Spd", "GCrs", "<b>"]) for _ in letters[1:])])
    sizes = {"n": 4, "N": 16, "Z": 64, "a": 64, "g": 2, "M": 1, "c": 2, "C": 2, "e": 4, "E": 4, "L": 4}
    size = sum(sizes.get(c) or struct.calcsize(c) for c in letters)
    texts = (b"GPS\0", letters.encode(), labels.encode()[:64])
    made = b"\xa3\x95\x80" + struct.pack("<BB4s16s64s", data[at + 3], min(255, 3 + size), *texts)
    return data[:at] + made + data[at + 89 :]


def lying_matrix(data: bytes, rng: Rng) -> bytes:
    """A MATLAB 5 file unpacked, with some words of its tags, dimensions and classes replaced, and packed again or not."""
    size = int.from_bytes(data[132:136], "little")
    packed = data[128:132] == b"\x0f\0\0\0"
    with contextlib.suppress(zlib.error):
        body = bytearray(zlib.decompress(data[136 : 136 + size]) if packed else data[128:])
        for _ in range(int(rng.integers(1, 4))):
            at = 4 * int(rng.integers(max(1, min(len(body), 600) // 4)))
            words = (*range(10), *range(14, 19), 2**16, 2**27, 2**31 - 1, 2**31, 2**32 - 8, int(rng.integers(2**32)))
            body[at : at + 4] = words[int(rng.integers(len(words)))].to_bytes(4, "little")
        if rng.random() < 0.5:
            made = zlib.compress(bytes(body))
            return data[:128] + struct.pack("<II", 15, len(made)) + made
        return data[:128] + bytes(body)
    return flip_bits(data, rng)


def lying_topic(data: bytes, rng: Rng) -> bytes:
    """A ULog with a format that holds itself, much of it, or other types; lengths fit."""
    fields = (
        b"uint64_t timestamp;self[9] s;",
        b"uint64_t timestamp;float[60000] x;",
        b"uint8_t timestamp;float x;",
        b"uint64_t timestamp;" + b"double x;" * 3000,
        b"float x;",
        b"uint64_t timestamp;nothing n;",
        b"char[16] timestamp;",
        b"uint64_t timestamp;float x;float x;",
        b"bool timestamp;int64_t[3] y;",
        b"uint64_t[2] timestamp;float a;",
    )
    name = bytes(rng.choice([b"self", b"sensor_combined", b"airspeed", b"inner"]))
    made = seeds.ulog_message(b"F", name + b":" + fields[int(rng.integers(len(fields)))])
    made += seeds.ulog_message(b"A", bytes([int(rng.integers(3)), int(rng.integers(4)), 0]) + name)
    at = int(rng.choice([59, 59, 59, int(rng.integers(min(16, len(data)), len(data) + 1))]))
    return data[:at] + made + data[at:]


def lying_rows(data: bytes, rng: Rng) -> bytes:
    """An SQLite file, sound, with cells that hold what is none of theirs."""
    values = (
        None,
        "",
        "nan",
        "\0",
        "[" * 900,
        b"\xff\xfe",
        b"",
        -1,
        0,
        2**62,
        -(2**63),
        1e308,
        float("inf"),
        "uint64[99999999] x",
    )
    columns = {"topics": ("name", "type", "id"), "messages": ("topic_id", "timestamp", "data"),
               "message_definitions": ("topic_type", "encoding", "encoded_message_definition")}  # fmt: skip
    file = sqlite3.connect(":memory:")
    with contextlib.suppress(sqlite3.Error, UnicodeDecodeError), contextlib.closing(file):
        file.deserialize(data)
        for table in rng.choice(list(columns), int(rng.integers(1, 4))):
            column = rng.choice(columns[str(table)])
            value = values[int(rng.integers(len(values)))]
            where = "" if rng.random() < 0.3 else f" where rowid % 7 = {int(rng.integers(7))}"
            with contextlib.suppress(sqlite3.IntegrityError, sqlite3.OperationalError):
                file.execute(f"update {table} set {column} = ?{where}", (value,))
        file.commit()
        return bytes(file.serialize())
    return flip_bits(data, rng)


# -------------------------------------------------------------------------------------------------------------- readers


def verb(*words: str) -> Reader:
    """A verb of the command line; FILE, OUT and ROOT stand for the input, a file to write and the project."""

    def read(path: Path, scratch: Path) -> object:
        places = {
            "FILE": str(path),
            "OUT": str(scratch / "out.mcap"),
            "CSV": str(_plain_csv(scratch)),
            "TXT": str(scratch / "o.csv"),
        }
        return sideslip.main([places.get(word, word) for word in words])

    return read


def _plain_csv(scratch: Path) -> Path:
    path = scratch / "plain.csv"
    if not path.exists():
        path.write_bytes(seeds.csv_inputs()[0])
    return path


def _logger_configuration(path: Path, scratch: Path) -> object:
    from daq.config import load_config
    from daq.sensors.config import SensorsConfig

    config, _ = load_config(path)
    assert isinstance(config.sensors, SensorsConfig)
    return config.scan.together, config.sensors.fitted


def _ground_configuration(path: Path, scratch: Path) -> object:
    from daq.transport.ports import parse_port
    from groundstation.live.config import load_ground_config

    config = load_ground_config(path)
    return [parse_port(port) for port in config.link.ports]


def _scenario(path: Path, scratch: Path) -> object:
    from firmware_sim.world.scenario import load_scenario

    scenario = load_scenario(path)
    return scenario.toml(), scenario.total_s


def _calibration(path: Path, scratch: Path) -> object:
    from groundstation.calibration.calibration_set import NOMINAL_DIRECTORY, load_calibration
    from groundstation.calibration.recording import calibrate_recording

    nominal = load_calibration(NOMINAL_DIRECTORY / "cdfp")
    folder = path.with_suffix("")
    folder.mkdir()
    path.rename(folder / "spoilt.toml")
    spoilt = load_calibration(folder)
    name = next(iter(spoilt.instruments))
    (folder / f"{name}.toml").write_text(spoilt.texts["spoilt.toml"])
    whole = nominal.with_texts({f"{name}.toml": spoilt.texts["spoilt.toml"]})
    return calibrate_recording(_raw(), whole)


def _bench_plan(path: Path, scratch: Path) -> object:
    from groundstation.calibration.bench import fit_bench
    from groundstation.calibration.bench_plan import load_plan
    from groundstation.calibration.calibration_set import NOMINAL_DIRECTORY, load_calibration

    return fit_bench(_raw(), load_plan(path), load_calibration(NOMINAL_DIRECTORY / "cdfp"))


def _raw() -> Path:
    return seeds.RECORDINGS / "cdfp_ld1_raw.mcap"


def _simulation(prefix: str) -> Reader:
    """A simulation asked at some states."""

    def read(path: Path, scratch: Path) -> object:
        from estimation.simulation.attach import simulation_of
        from estimation.simulation.oracle import VARIABLES, States

        simulation = simulation_of(f"{prefix}{path}")
        rng = np.random.default_rng(1)
        values = {n: rng.uniform(-0.3, 0.3, 5) + (20.0 if n == "V" else 0.0) for n in VARIABLES}
        assert np.isfinite(simulation.oracle.coefficients(States(values, np.full(5, 1.2), np.zeros(5)))).all()
        return simulation

    return read


def _jsbsim(path: Path, scratch: Path) -> object:
    """In a folder of its own, as JSBSim wants it."""
    folder = scratch / "aircraft" / "case"
    folder.mkdir(parents=True, exist_ok=True)
    path.rename(folder / "case.xml")
    return _simulation("jsbsim:")(folder / "case.xml", scratch)


def _campaign(path: Path, scratch: Path) -> object:
    from estimation.campaign.plan import read_plan
    from estimation.campaign.sources import entries_of
    from estimation.campaign.work_list import work_list
    from sideslip.simulated import simulator

    plan = read_plan(path)
    return work_list(plan, entries_of(plan, scratch, simulator()), scratch)


def _manoeuvre(path: Path, scratch: Path) -> object:
    from daq.contract.manoeuvre import load_manoeuvre

    return load_manoeuvre(path).digest


def _limits(path: Path, scratch: Path) -> object:
    from estimation.design.limits import load_limits

    return load_limits(path)


def _aircraft(path: Path, scratch: Path) -> object:
    from estimation.aircraft import load_aircraft
    from estimation.models.load import load_model

    craft = load_aircraft(path)
    return [load_model(name, craft) for name in ("lateral-simple", "longitudinal")]


def _model(path: Path, scratch: Path) -> object:
    from estimation.models.load import read_model, write_model

    model = read_model(path)
    again = scratch / "again" / path.name  # a model without a name is called as its file
    write_model(model, again)
    assert read_model(again).digest == model.digest
    return model


def _effects(path: Path, scratch: Path) -> object:
    from estimation.gap.effects.catalogue import load_effects

    return load_effects(path)


def _expression(path: Path, scratch: Path) -> object:
    from estimation.models.expressions import addends_in, evaluate, names_in, parse, products_in

    text = path.read_bytes().decode("utf-8", "replace")
    parse.cache_clear()
    products_in(text)
    assert "".join(addends_in(text)).split() == " ".join(text.replace("^", "**").split()).split()
    symbols = dict.fromkeys(names_in(text), np.float64(0.3))
    with np.errstate(all="ignore"):
        value = evaluate(text, symbols, _functions())
    assert np.ndim(value) == 0
    return value


def _functions() -> dict[str, Callable[..., Any]]:
    names = {
        "asin": "arcsin",
        "acos": "arccos",
        "atan": "arctan",
        "atan2": "arctan2",
        "min": "minimum",
        "max": "maximum",
    }
    from estimation.models.expressions import FUNCTIONS

    return {name: getattr(np, names.get(name, name)) for name in FUNCTIONS}


def _ubx(path: Path, scratch: Path) -> object:
    from daq.sensors.ubx import NAV_PVT, UbxParser, parse_nav_pvt

    data = path.read_bytes()
    parser = UbxParser()
    used = 0
    for start in range(0, len(data), 61):
        for message, payload in parser.feed(data[start : start + 61]):
            used += len(payload) + 8
            if message == NAV_PVT and len(payload) == 92:
                fix = parse_nav_pvt(payload)
                assert fix.utc_ns >= 0
    assert 0 <= len(data) - used - parser.skipped < 8 + 256 + 1  # what is not told is still waiting for its end
    return used


def _key(path: Path, scratch: Path) -> object:
    from daq.transport.signing import load_key

    with contextlib.suppress(OSError):
        path.chmod(0o600)
    assert len(load_key(path)) == 32
    return None


def _state(path: Path, scratch: Path) -> object:
    from daq.transport.signing import load_state

    state = load_state(path)
    assert all(math.isfinite(v) for v in (state.sent, state.heard))
    return state


IMPORT = verb("import", "FILE", "-o", "OUT", "--accept-implausible")

VERBS_OF_A_FLIGHT = (
    verb("check", "FILE"),
    verb("estimate", "FILE", "--method", "ls", "--structure", "off", "--aircraft", "cdfp"),
    verb("frequency", "FILE", "--input", "delta_a", "--output", "p"),
    verb("performance", "FILE", "--aircraft", "cdfp"),
    verb("reconstruct", "FILE", "-o", "TXT"),
    verb("export", "FILE", "-o", "TXT"),
    verb("watch", "FILE", "--model", "lateral", "--aircraft", "cdfp"),
    verb("match", str(ROOT / "docs/examples/short_period.toml"), "FILE", "--aircraft", "cdfp"),
)

KINDS: dict[str, Kind] = {
    k.name: k
    for k in (
        Kind("csv", ".csv", seeds.csv_inputs, (*TEXT, *TEXT, *BYTES),
             (IMPORT, verb("info", "FILE"), verb("import", "FILE", "-o", "TXT", "--rate", "30", "--split")), 2.0),
        Kind("parquet", ".parquet", seeds.parquet_inputs, BYTES, (IMPORT, verb("info", "FILE")), 2.0),
        Kind("matlab", ".mat", lambda: seeds.matlab_inputs()[:3], (*BYTES, lying_matrix, lying_matrix), (IMPORT,), 1.5),
        Kind("matlab 7.3", ".mat", lambda: seeds.matlab_inputs()[3:], BYTES, (IMPORT,), 0.5, quick=4),
        Kind("ulog", ".ulg", seeds.ulog_inputs, (*BYTES, lying_topic, lying_topic), (IMPORT,), 1.5),
        Kind("dataflash", ".bin", seeds.dataflash_inputs, (*BYTES, lying_format, lying_format), (IMPORT,), 1.5),
        Kind("tlog", ".tlog", seeds.tlog_inputs, (*BYTES, new_checksums, new_checksums, new_checksums),
             (IMPORT, verb("info", "FILE")), 1.5),
        Kind("ubx", ".ubx", seeds.ubx_inputs, BYTES, (_ubx,)),
        Kind("mapping", ".toml", seeds.mapping_inputs, TOML,
             (verb("import", "CSV", "--map", "FILE", "-o", "OUT", "--accept-implausible"),)),
        Kind("logger", ".toml", lambda: seeds.toml_inputs("daq/configs/*.toml"), TOML, (_logger_configuration,)),
        Kind("ground", ".toml", seeds.ground_inputs, TOML, (_ground_configuration,)),
        Kind("scenario", ".toml", lambda: seeds.toml_inputs("firmware_sim/scenarios/*.toml"), TOML, (_scenario,)),
        Kind("calibration", ".toml", lambda: seeds.toml_inputs("groundstation/calibration/files/cdfp/*.toml"), TOML,
             (_calibration,), quick=8),
        Kind("bench plan", ".toml", seeds.plan_inputs, TOML, (_bench_plan,), 0.5),
        Kind("sitl", ".json", seeds.sitl_inputs, (*TEXT, *BYTES), (_simulation("ardupilot:"),)),
        Kind("sdf", ".sdf", seeds.sdf_inputs, (*TEXT, *BYTES), (_simulation("gazebo:"),)),
        Kind("aircraft", ".toml", lambda: seeds.toml_inputs("estimation/aircraft/*.toml"), TOML, (_aircraft,)),
        Kind("model", ".toml", seeds.model_inputs, TOML, (_model,)),
        Kind("effects", ".toml", seeds.effect_inputs, TOML, (_effects,)),
        Kind("expression", ".txt", seeds.expression_inputs, TEXT, (_expression,)),
        Kind("signing key", ".key", seeds.key_inputs, (*BYTES, *TEXT), (_key,), 0.5),
        Kind("signing state", ".state", seeds.state_inputs, (*TEXT, *TEXT, *BYTES), (_state,), 0.5),
        Kind("recording", ".mcap", seeds.recording_inputs, BYTES,
             (verb("verify", "FILE"), verb("info", "FILE"), verb("calibrate", "FILE", "-o", "OUT", "--salvage"),
              verb("recover", "FILE", "-o", "OUT")), 0.5, quick=4),
        Kind("bag", ".mcap", seeds.bag_inputs, BYTES, (verb("info", "FILE"), IMPORT), quick=8),
        Kind("sqlite bag", ".db3", seeds.sqlite_bag_inputs, (*BYTES, *[lying_rows] * 6), (verb("info", "FILE"), IMPORT), 0.5,
             quick=8),
        Kind("campaign plan", ".toml", seeds.campaign_inputs, TOML, (_campaign,)),
        Kind("manoeuvre", ".toml", seeds.manoeuvre_inputs, TOML, (_manoeuvre,)),
        Kind("limits", ".toml", seeds.limits_inputs, TOML, (_limits,)),
        Kind("jsbsim", ".xml", seeds.jsbsim_inputs, (*TEXT, *BYTES), (_jsbsim,)),
        Kind("flight of a verb", ".csv", seeds.flight_inputs, (*TEXT, *BYTES), VERBS_OF_A_FLIGHT, 1.0, quick=8),
    )
}  # fmt: skip
