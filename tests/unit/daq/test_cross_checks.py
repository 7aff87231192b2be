"""Static pressure against GPS height, the magnetic field and the surfaces' potentiometers, from made-up counts."""

from collections.abc import Iterator, Mapping
from pathlib import Path

import pytest

from daq.config import LoggerConfig
from daq.contract.scan import GroupStatus, Scan, SensorState
from daq.recorder.config import RecorderConfig
from daq.sensors.ads1115 import AnalogConfig
from daq.sensors.config import SensorsConfig
from daq.service.checks import PreflightCheck, PreflightVerdict
from daq.service.cross_checks import cross_checks, sea_level_pressure

FACTS = {"static.scale_pa": "0.015625", "static.scale_k": "1e-3", "static.offset_k": "0"}
WELL: Mapping[str, float] = {
    "static_pressure": 98_000.0 / 0.015625, "static_temperature": 288_150.0, "gnss_fix": 3, "height_msl_mm": 300_000,
    "vertical_accuracy_mm": 6000, "mag_x": 150, "mag_y": 20, "mag_z": 280, "elevon_left_pot": 16_000,
    "elevon_right_pot": 15_000, "rudder_pot": 17_000,
}  # fmt: skip
GROUPS = ("static", "gnss", "mag", "analog_a", "analog_b")


def scans(travel: float = 0.0, **changes: float) -> Iterator[Scan]:
    """Forty scans of an aircraft at 300 m that is well but for `changes`; travel: of the left elevon in its range."""
    groups = {g: GroupStatus(SensorState.OK) for g in GROUPS}
    for n in range(40):
        values = {**WELL, **changes}
        values["elevon_left_pot"] += travel * 32767 * (n / 39)
        yield Scan(n, n * 50_000_000, 0, 0, 0, groups, values)


def rows(tmp_path: Path, required: bool = True, travel: float = 0.0, **changes: float) -> dict[str, PreflightCheck]:
    a, b = (AnalogConfig(required=required, address=address) for address in (0x48, 0x49))
    config = LoggerConfig(
        recorder=RecorderConfig(directories=(tmp_path,)), sensors=SensorsConfig(analog_a=a, analog_b=b)
    )
    return {c.name: c for c in cross_checks(config, list(scans(travel, **changes)), lambda: FACTS)}


def test_a_healthy_aircraft_is_go_in_every_row(tmp_path: Path) -> None:
    found = rows(tmp_path)
    assert list(found) == ["static height", "magnetic field", "surfaces"]
    assert {c.verdict for c in found.values()} == {PreflightVerdict.GO}
    assert "1016 hPa at sea level" in found["static height"].text
    assert "48 uT" in found["magnetic field"].text
    assert "move the sticks" in found["surfaces"].text
    assert "moved: elevon_left" in rows(tmp_path, travel=0.1)["surfaces"].text


def test_sea_level_pressure_is_that_of_the_standard_atmosphere() -> None:
    """ICAO Doc 7488: 954.61 hPa at 500 m, 794.95 at 2000 m."""
    assert sea_level_pressure(95_461.0, 500.0) == pytest.approx(101_325.0, abs=5.0)
    assert sea_level_pressure(79_495.0, 2000.0) == pytest.approx(101_325.0, abs=5.0)


@pytest.mark.parametrize(
    ("changes", "row", "words"),
    [
        ({"static_pressure": 91_000.0 / 0.015625}, "static height", "943 hPa at sea level"),
        ({"height_msl_mm": 1_200_000}, "static height", "tube"),
        ({"mag_x": 20, "mag_z": 30}, "magnetic field", "iron"),
        ({"mag_z": 900}, "magnetic field", "137 uT"),
        ({"rudder_pot": 32_760}, "surfaces", "rudder_pot at an end"),
        ({"elevon_right_pot": 0, "rudder_pot": 0}, "surfaces", "elevon_right_pot and rudder_pot at an end"),
    ],
)
def test_what_contradicts_is_named_with_value_and_limit(
    tmp_path: Path, changes: dict[str, float], row: str, words: str
) -> None:
    found = rows(tmp_path, **changes)
    assert found[row].verdict is not PreflightVerdict.GO
    assert words in found[row].text
    assert all(c.verdict is PreflightVerdict.GO for n, c in found.items() if n != row)


def test_a_sensor_that_is_required_forbids_the_flight(tmp_path: Path) -> None:
    assert rows(tmp_path, rudder_pot=0)["surfaces"].verdict is PreflightVerdict.NO_GO
    assert rows(tmp_path, required=False, rudder_pot=0)["surfaces"].verdict is PreflightVerdict.CAUTION


def test_a_poor_fix_says_nothing_of_pressure(tmp_path: Path) -> None:
    assert "static height" not in rows(tmp_path, height_msl_mm=1_200_000, vertical_accuracy_mm=90_000)
    assert "static height" not in rows(tmp_path, gnss_fix=2)
