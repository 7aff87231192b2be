"""UBX framing against messages known from u-blox's own tools, the parser against damage, the driver against a fake port."""

import datetime as dt
import struct

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from daq.contract.scan import SensorState
from daq.sensors.base import SelfTestError
from daq.sensors.timebase import TimeBase
from daq.sensors.ublox import GnssConfig, Ublox
from daq.sensors.ubx import NAV_PVT, UbxParser, frame, parse_nav_pvt, setup_m8, setup_m9
from tests.unit.daq.fakes import FakePort

MS = 1_000_000


def pvt(
    itow: int = 1000, nano: int = -7, valid: int = 0x07, fix: int = 3, flags: int = 0x01, second: int = 30
) -> bytes:
    """NAV-PVT of 2026-11-21 10:20:30, written field by field from the interface description."""
    out = struct.pack("<I", itow) + struct.pack("<H", 2026) + bytes((11, 21, 10, 20, second, valid))
    out += struct.pack("<I", 25) + struct.pack("<i", nano) + bytes((fix, flags, 0, 12))
    out += struct.pack("<ii", 773456789, 130654321)  # longitude, latitude
    out += struct.pack("<ii", 950_000, 912_345)  # ellipsoid, mean sea level
    out += struct.pack("<II", 1500, 2500)
    out += struct.pack("<iii", 15_000, -200, 30) + struct.pack("<ii", 15_001, 0)
    out += struct.pack("<II", 300, 50_000) + struct.pack("<H", 150) + bytes(6) + struct.pack("<ihH", 0, 0, 0)
    return out


def test_frames_agree_with_known_messages() -> None:
    assert frame((0x06, 0x08), bytes.fromhex("C80001000100")).hex() == "b56206080600c80001000100de6a"
    assert frame((0x06, 0x01), bytes.fromhex("F00000")).hex() == "b56206010300f00000fa0f"


def test_setup_messages_ask_for_the_rate() -> None:
    assert bytes.fromhex("b5620608060064000100010 07a12".replace(" ", "")) in setup_m8(10.0)
    valset = b"".join(setup_m9(10.0))
    assert bytes.fromhex("0900912001") in valset  # CFG-MSGOUT-UBX_NAV_PVT_USB = 1
    assert bytes.fromhex("0200781000") in valset  # CFG-USBOUTPROT-NMEA = 0
    assert len(setup_m9(10.0)) == 4, "a receiver without USB refuses the message with the keys of USB alone"
    assert bytes.fromhex("01002130 6400".replace(" ", "")) in valset  # CFG-RATE-MEAS = 100 ms
    assert bytes.fromhex("07009120 01".replace(" ", "")) in valset  # CFG-MSGOUT-UBX_NAV_PVT_UART1 = 1


def test_nav_pvt_fields() -> None:
    fix = parse_nav_pvt(pvt())
    moment = dt.datetime(2026, 11, 21, 10, 20, 30, tzinfo=dt.UTC)
    assert fix.utc_ns == round(moment.timestamp()) * 10**9 - 7
    assert (fix.itow_ms, fix.fix, fix.fix_ok, fix.satellites) == (1000, 3, True, 12)
    assert (fix.longitude_e7, fix.latitude_e7, fix.height_msl_mm) == (773456789, 130654321, 912_345)
    assert (fix.velocity_north_mm, fix.velocity_east_mm, fix.velocity_down_mm) == (15_000, -200, 30)
    assert (fix.time_accuracy_ns, fix.horizontal_accuracy_mm, fix.vertical_accuracy_mm) == (25, 1500, 2500)
    assert fix.speed_accuracy_mm == 300


@pytest.mark.parametrize("valid", [0x00, 0x01, 0x02, 0x03, 0x05, 0x06])
def test_time_counts_only_when_fully_resolved(valid: int) -> None:
    assert parse_nav_pvt(pvt(valid=valid)).utc_ns == 0


@pytest.mark.parametrize(
    ("at", "value"),
    [(4, 0), (4, 9999), (4, 65535), (6, 0), (6, 13), (6, 255), (7, 0), (7, 32), (8, 24), (9, 60), (10, 61)],
)
def test_a_date_that_is_none_is_no_time_and_no_error(at: int, value: int) -> None:
    """Byte offsets of year (two bytes), month, day, hour, minute, second."""
    payload = bytearray(pvt())
    payload[at : at + (2 if at == 4 else 1)] = value.to_bytes(2 if at == 4 else 1, "little")
    assert parse_nav_pvt(bytes(payload)).utc_ns == 0


def test_a_week_number_that_rolled_over_is_put_right_and_told() -> None:
    payload = bytearray(pvt())
    payload[4:8] = struct.pack("<HBB", 2007, 4, 7)  # 2026-11-21 less 1024 weeks
    now, port = [10**9], FakePort()
    base = TimeBase(0, 50 * MS)
    driver = Ublox(GnssConfig(generation="none"), port, lambda: now[0], base)
    port.received += frame(NAV_PVT, bytes(payload))
    values = driver.read().values
    assert values["gnss_utc_ns"] == parse_nav_pvt(pvt()).utc_ns
    assert driver.metadata()["rollovers"] == "1"
    relation = base.relation(now[0])
    assert relation is not None
    assert abs(relation.utc_ns(now[0]) - parse_nav_pvt(pvt()).utc_ns) < 10**9
    port.received += frame(NAV_PVT, pvt())
    driver.read()
    assert "rollovers" not in driver.metadata()


def test_leap_second_is_not_an_error() -> None:
    assert parse_nav_pvt(pvt(second=60)).utc_ns - parse_nav_pvt(pvt(second=59)).utc_ns == 10**9


def test_other_length_is_refused() -> None:
    with pytest.raises(ValueError, match="92 bytes, not 84"):
        parse_nav_pvt(bytes(84))


@given(st.binary(max_size=400), st.integers(1, 40))
def test_parser_swallows_anything(noise: bytes, step: int) -> None:
    parser = UbxParser()
    for start in range(0, len(noise), step):
        list(parser.feed(noise[start : start + step]))
    good = frame(NAV_PVT, pvt())
    found = [m for m, _ in parser.feed(bytes(1200) + good + bytes(1200) + good)]
    assert found.count(NAV_PVT) >= 1


def test_parser_loses_exactly_the_damaged_frames(rng: np.random.Generator) -> None:
    """Flipped bits, lost bytes and NMEA in between: every untouched frame comes out, and no altered one."""
    stream, intact = bytearray(), []
    for i in range(400):
        data = bytearray(frame(NAV_PVT, pvt(itow=i)))
        kind = rng.integers(6)
        if kind == 0:
            data[rng.integers(len(data))] ^= 1 << int(rng.integers(8))
        elif kind == 1:
            del data[rng.integers(len(data))]
        else:
            intact.append(i)
        if kind == 2:
            stream += b"$GNRMC,,V,,,,,,,,,,N*4D\r\n"
        stream += data
    parser = UbxParser()
    found = []
    for start in range(0, len(stream), 37):
        found += [parse_nav_pvt(p).itow_ms for _, p in parser.feed(bytes(stream[start : start + 37]))]
    assert found == intact


def test_cut_frame_waits_for_its_rest() -> None:
    parser, data = UbxParser(), frame(NAV_PVT, pvt())
    assert list(parser.feed(data[:50])) == []
    assert [m for m, _ in parser.feed(data[50:])] == [NAV_PVT]


class TestDriver:
    def driver(self, generation: str = "m9") -> tuple[Ublox, FakePort, list[int]]:
        port, now = FakePort(), [10**9]
        config = GnssConfig(generation=generation)  # type: ignore[arg-type]
        return Ublox(config, port, lambda: now[0], TimeBase(60 * MS, 50 * MS)), port, now

    def test_set_up_sends_the_configuration_and_waits_for_a_fix(self) -> None:
        driver, port, now = self.driver()
        setup = driver.initialise()
        now[0] += next(setup)
        assert port.sent.startswith(b"\xb5\x62\x06\x8a")
        with pytest.raises(StopIteration):
            for _ in range(200):  # a receiver that answers nothing is waited for at each message
                port.received += frame(NAV_PVT, pvt())
                now[0] += next(setup)

    @pytest.mark.parametrize(("refused", "passes"), [((), True), ((2, 3), True), ((0,), False), ((0, 1, 2, 3), False)])
    def test_answers_are_read(self, refused: tuple[int, ...], passes: bool) -> None:
        """A port that the receiver has not may be refused; rate and dynamic model not."""
        driver, port, now = self.driver()
        setup, heard, number = driver.initialise(), 0, 0
        fault = ""
        try:
            for _ in range(400):
                now[0] += next(setup)
                if len(port.sent) > heard:
                    heard = len(port.sent)
                    port.received += frame((0x05, 0x00 if number in refused else 0x01), bytes((0x06, 0x8A)))
                    number += 1
                port.received += frame(NAV_PVT, pvt())
        except StopIteration:
            pass
        except SelfTestError as error:
            fault = str(error)
        assert (fault == "") == passes
        assert passes or "refuses (NAK)" in fault

    def test_silent_receiver_fails_its_self_test(self) -> None:
        driver, _, now = self.driver("none")
        with pytest.raises(SelfTestError, match="no byte from the GPS"):
            for wait in driver.initialise():
                now[0] += wait

    def test_chatting_receiver_without_fixes_is_told_apart(self) -> None:
        driver, port, now = self.driver("none")
        with pytest.raises(SelfTestError, match="no NAV-PVT from the GPS"):
            for wait in driver.initialise():
                now[0] += wait
                port.received += b"$GNGGA,,*\r\n"

    def test_each_fix_is_reported_once_and_none_is_lost(self) -> None:
        driver, port, _ = self.driver()
        port.received += frame(NAV_PVT, pvt(itow=100)) + frame(NAV_PVT, pvt(itow=200))
        first, second, third = driver.read(), driver.read(), driver.read()
        assert (first.values["gnss_itow"], second.values["gnss_itow"]) == (100, 200)
        assert (third.state, third.values) == (SensorState.OK, {})

    def test_no_fix_is_recorded_but_not_trusted(self) -> None:
        driver, port, _ = self.driver()
        port.received += frame(NAV_PVT, pvt(fix=0, flags=0))
        reading = driver.read()
        assert reading.state is SensorState.RECOVERING
        assert reading.values["gnss_fix"] == 0

    def test_missing_fixes_are_stale_then_absent(self) -> None:
        driver, port, now = self.driver()
        port.received += frame(NAV_PVT, pvt())
        driver.read()
        now[0] += 400 * MS
        assert driver.read().state is SensorState.STALE
        now[0] += 2000 * MS
        assert driver.read().state is SensorState.ABSENT
