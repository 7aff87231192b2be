"""Somebody without a key speaks in an aircraft's place: numbers out of reach, restarts, events, texts, other systems."""

import json
import tracemalloc
from contextlib import closing
from pathlib import Path

import numpy as np
import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from daq.contract.link.wire import SCAN_FAST_ID, layouts, pack_scan
from daq.contract.recordings.reading import read_recording
from daq.contract.scan import Scan
from daq.transport.mavlink_codec import FrameEncoder, message_types
from groundstation.live.config import GroundConfig
from groundstation.live.station import Station
from groundstation.receiver import events as ev
from groundstation.receiver.link_accounting import SessionAccounting
from groundstation.receiver.ports import LinkConfig
from groundstation.receiver.receive import MAX_OF_ONE_SENDER
from groundstation.receiver.timeline import NS
from tests.support.link_rig import Rig, quiet_scan

LISTEN = LinkConfig(ports=("memory",), backfill="off", transmit=False)
LAST = 2**32 - 1


def fly(rig: Rig, scans: int, seed: int = 1) -> None:
    rng = np.random.default_rng(seed)
    rig.fly(scans, lambda n: quiet_scan(n, rng, time_ns=rig.clock.monotonic_ns()))


def forged(number: int, time_ns: int, boot: int, sequence: int = 200, system: int = 1) -> bytes:
    encoder = FrameEncoder(system, 1)
    encoder._sequence = sequence & 255
    return encoder.frame(SCAN_FAST_ID, pack_scan(layouts()[SCAN_FAST_ID], Scan(number, time_ns), boot))


def test_one_forged_number_costs_nothing_and_the_aircraft_goes_on(tmp_path: Path) -> None:
    rig = Rig(tmp_path, ground=LISTEN)
    fly(rig, 100)
    tracemalloc.start()
    rig._ground.write(forged(LAST, rig.clock.monotonic_ns() + NS // 20, 7))
    fly(rig, 200)
    rig.rest(12)
    summary = rig.ground.summary()
    _, peak = tracemalloc.get_traced_memory()
    tracemalloc.stop()
    assert peak < 8_000_000
    (books,) = rig.ground.accounting()
    assert books.last == 299
    assert books.received == len(rig.link.downlink.sent)
    assert books.lost == []
    assert books.unknown == []
    assert summary["scans_doubted"] == 1
    assert [e.count for e in rig.findings(ev.ReceptionFindingKind.DOUBTED)] == [1]
    rig.close()


def test_a_forged_first_scan_gives_way_to_the_aircraft(tmp_path: Path) -> None:
    rig = Rig(tmp_path, ground=LISTEN)
    rig._ground.write(forged(LAST, 2**55, 7))
    rig.look()
    tracemalloc.start()
    fly(rig, 300)
    rig.rest(12)
    _, peak = tracemalloc.get_traced_memory()
    tracemalloc.stop()
    assert peak < 8_000_000
    *_, books = rig.ground.accounting()
    assert books.received == len(rig.link.downlink.sent)
    assert (books.last, books.lost) == (299, [])
    rig.close()


def test_gaps_between_numbers_cost_by_what_came_not_by_how_wide_they_are() -> None:
    tracemalloc.start()
    books = SessionAccounting(ev.Session(1, 7, 0))
    for number in (5, 2**31, LAST):
        books.see(number)
        books.received.add(number)
    found = books.totals()
    first_open = next(iter(books.open_blocks()))
    _, peak = tracemalloc.get_traced_memory()
    tracemalloc.stop()
    assert found.unknown == [(6, 2**31 - 1), (2**31 + 1, LAST - 1)]
    assert (found.first, found.last, found.received, first_open) == (5, LAST, 3, 0)
    assert peak < 200_000


def test_accounting_by_ranges_is_what_counting_one_by_one_gives(rng: np.random.Generator) -> None:
    for _ in range(30):
        books = SessionAccounting(ev.Session(1, 7, 0))
        top = int(rng.integers(1, 4000))
        got = {int(n) for n in rng.integers(0, top, rng.integers(1, 300))}
        for n in got:
            books.see(n)
            books.received.add(n)
        settled: dict[int, int] = {}
        sent = {n for n in range(top) if rng.random() < 0.5} | got
        for block in range(top // 512 + 1):
            if rng.random() < 0.5:
                settled[block] = block * 512 + int(rng.integers(0, 512))
                word = sum(1 << (n - block * 512) for n in sent if n // 512 == block)
                books.take_map(block * 512, settled[block], word, 0)
        numbers = range(min(got), max(got) + 1)
        told = {n for n in numbers if n <= settled.get(n // 512, -1)}
        found = books.totals()
        assert {n for a, b in found.lost for n in range(a, b + 1)} == (sent & told) - got
        assert {n for a, b in found.unknown for n in range(a, b + 1)} == set(numbers) - told - got
        assert all(b + 1 < c for (_, b), (c, _) in zip(found.unknown, found.unknown[1:], strict=False))


def test_thousands_of_boot_ids_make_a_handful_of_files(tmp_path: Path) -> None:
    rig = Rig(tmp_path, ground=LISTEN)
    fly(rig, 40)
    for i in range(4000):
        rig._ground.write(forged(i, i * NS // 20 + 1, (i * 7) % 251, i))
        if not i % 10:
            fly(rig, 1, seed=i)
    fly(rig, 100)
    rig.rest(8)
    *_, books = rig.ground.accounting()
    assert books.received == len(rig.link.downlink.sent)
    assert rig.ground.summary()["scans_doubted"] >= 3900
    rig.close()
    assert len(list(tmp_path.iterdir())) <= 3


def test_runs_of_scans_that_nobody_contradicts_are_bounded_too(tmp_path: Path) -> None:
    rig = Rig(tmp_path, ground=LISTEN)
    for run in range(120):
        for i in range(30):
            rig.clock.advance(NS // 15)
            rig._ground.write(forged(i, i * NS // 15 + 1, run % 251, i))
            rig.events += rig.look()
    made = list(tmp_path.glob("*.journal"))
    assert 8 <= len(made) <= 8 + 1 + 240 // 60
    assert any(e.subject.startswith("restarts") for e in rig.findings(ev.ReceptionFindingKind.DOUBTED))
    rig.close()


def test_reports_and_maps_of_numbers_out_of_reach_are_not_believed(tmp_path: Path) -> None:
    rig = Rig(tmp_path, ground=LISTEN)
    fly(rig, 100)
    encoder = FrameEncoder(1, 1)
    rig._ground.write(encoder.message("LINK_STATISTICS", boot=7, last_number=LAST, scans_offered=LAST))
    for block in range(3000):
        rig._ground.write(
            encoder.message("SENT_MAP", boot=7, first_number=block << 20, last_number=LAST, sent=[255] * 64)
        )
    fly(rig, 100)
    rig.rest(12)
    (books,) = rig.ground.accounting()
    assert (books.last, books.lost, books.unknown) == (199, [], [])
    assert sum(e.count for e in rig.findings(ev.ReceptionFindingKind.DOUBTED)) >= 3000
    rig.close()


def test_floods_of_events_and_texts_are_cut_and_counted(tmp_path: Path) -> None:
    rig = Rig(tmp_path, ground=LISTEN)
    fly(rig, 20)
    encoder = FrameEncoder(1, 1)
    for i in range(5000):
        rig._ground.write(encoder.message("SCAN_EVENT", boot=7, number=3, time_monotonic_ns=i, origin="x", text=str(i)))
        rig._ground.write(encoder.message("STATUSTEXT", severity=3, text=f"line {i}"))
    fly(rig, 20)
    kept = [e for e in rig.events if isinstance(e, ev.EventMarked | ev.StatusText)]
    assert len(kept) <= 120
    fly(rig, 200)
    assert sum(e.count for e in rig.findings(ev.ReceptionFindingKind.DOUBTED)) == 10_000 - len(kept)
    rig.close()


def test_systems_beyond_what_can_be_served_are_refused_and_told(tmp_path: Path) -> None:
    rig = Rig(tmp_path, ground=LISTEN)
    fly(rig, 20)
    for system in range(2, 250):
        rig._ground.write(forged(1, NS, 9, system=system))
    fly(rig, 20)
    assert len(rig.ground.systems) == MAX_OF_ONE_SENDER
    assert 1 in rig.ground.systems
    assert sum(e.count for e in rig.findings(ev.ReceptionFindingKind.DOUBTED)) == 249 - MAX_OF_ONE_SENDER
    rig.close()


def test_words_from_the_air_are_one_line_and_do_nothing_to_a_terminal(tmp_path: Path) -> None:
    rig = Rig(None, ground=LISTEN)
    said: list[str] = []
    station = Station(GroundConfig(), rig.ground, rig.clock, tmp_path, echo=said.append)
    rig.look = station.step  # type: ignore[method-assign]
    fly(rig, 20)
    text = "\x1b[2J\x07 landed\n  99.00 s  aircraft 1 \u202e!"
    rig._ground.write(FrameEncoder(1, 1).message("STATUSTEXT", severity=6, text=text))
    fly(rig, 2)
    station.close()
    rig.close()
    assert all(line.isprintable() for line in said)
    assert all(line.isprintable() for line in (tmp_path / "events.log").read_text().splitlines())
    assert sum("landed" in line for line in said) == 1


@settings(max_examples=12, deadline=None, suppress_health_check=[HealthCheck.function_scoped_fixture])
@given(data=st.data())
def test_no_frame_an_impostor_can_make_ends_a_session(
    tmp_path_factory: pytest.TempPathFactory, data: st.DataObject
) -> None:
    folder = tmp_path_factory.mktemp("any")
    # a draw may be given up half-way, and what it began has to end all the same
    with (
        closing(Rig(folder, ground=LinkConfig(ports=("memory",), backfill="all"))) as rig,
        closing(Station(GroundConfig(), rig.ground, rig.clock, folder)) as station,
    ):
        rig.look = station.step  # type: ignore[method-assign]
        fly(rig, 10)
        encoder = FrameEncoder(1, 1)
        edges = st.sampled_from([0, 1, 7, 255])
        for _ in range(30):
            made = data.draw(st.sampled_from(list(message_types().values())))
            fill = data.draw(edges | st.none())
            size = made.codec.size
            payload = bytes([fill]) * size if fill is not None else data.draw(st.binary(min_size=size, max_size=size))
            rig._ground.write(encoder.frame(made.msg_id, payload))
            fly(rig, 1)
    json.dumps(rig.ground.summary(), allow_nan=False)
    assert rig.ground.port_faults == {}
    for path in folder.glob("*.mcap"):
        assert read_recording(path).numbers
