"""A channel of the table is a column of the flight or an error that says what is missing, never NaN in silence."""

from collections.abc import Callable
from dataclasses import replace

import numpy as np
import pytest

from daq.contract.channel_rows import Channel, FlightColumn
from daq.contract.channels import COLUMNS
from daq.contract.scan import Scan
from groundstation.calibration.apply import Calibrator, calibrate
from groundstation.calibration.calibration_set import CalibrationSet
from groundstation.calibration.columns import COMBINED, CombinedColumns, DirectColumn, direct_columns
from groundstation.calibration.scan_table import scan_table
from groundstation.calibration.schema import CalibrationError

MakeScans = Callable[..., list[Scan]]
OZONE = Channel("ozone", "analog_a", "u16", "V", "ozone", 1e-3, columns=("ozone",))
OZONE_COLUMN = FlightColumn("ozone", "V", "ozone", "/ozone", (0.0, 5.0))
CURVE = """
format = 1
instrument = "ozone_sensor"
kind = "curve"
channel = "analog_1"
date = 2026-01-01
method = "bench"
curve = { kind = "polynomial", input_unit = "V", output_unit = "V", coefficients = [0.0, 2.0], valid = [0.0, 5.0] }
"""


def direct(calibration: CalibrationSet, channel: Channel = OZONE, column: FlightColumn = OZONE_COLUMN) -> DirectColumn:
    return direct_columns(calibration, (column,), (channel,))[0]


def without(nominal: CalibrationSet, *files: str) -> CalibrationSet:
    return CalibrationSet.from_texts("poor", {n: t for n, t in nominal.texts.items() if n not in files})


def test_every_column_of_the_table_is_made_by_a_rule_or_of_one_channel(
    make_scans: MakeScans, nominal: CalibrationSet
) -> None:
    made = CombinedColumns(nominal, scan_table(make_scans(3)), {}, aligned=False).make()
    assert set(made) == {c.name for c in COLUMNS}
    assert {d.column.name for d in direct_columns(nominal)} == set(made) - COMBINED


def test_a_channel_without_a_file_is_its_column_at_data_sheet_scale(nominal: CalibrationSet) -> None:
    assert direct(nominal).uncalibrated
    assert direct(nominal).reading == "ozone"


def test_a_channel_with_a_file_is_its_column_by_the_curve(make_scans: MakeScans, nominal: CalibrationSet) -> None:
    """The same recording at data-sheet scale and through a curve of slope two."""
    plain = without(nominal, "analog_1.toml")
    curved = CalibrationSet.from_texts("own", {**plain.texts, "ozone.toml": CURVE})
    scans = [replace(s, values={**s.values, "analog_1": 8000 + 7 * i}) for i, s in enumerate(make_scans(30))]
    flights = [calibrate(scans, chosen) for chosen in (plain, curved)]
    values = [f["analog_1"] for f in flights]
    np.testing.assert_allclose(values[0], (8000 + 7 * np.arange(30)) * 4.096 / 32768)
    np.testing.assert_allclose(values[1], 2.0 * values[0])


@pytest.mark.parametrize(
    ("channel", "column", "says"),
    [
        (replace(OZONE, scale=None), OZONE_COLUMN, "no scale for ozone; add a file of kind curve"),
        (
            OZONE,
            replace(OZONE_COLUMN, unit="ppb"),
            "ozone is in 'V' and column ozone in 'ppb'; add a file of kind curve",
        ),
    ],
)
def test_a_channel_that_is_not_its_column_says_what_is_missing(
    nominal: CalibrationSet, channel: Channel, column: FlightColumn, says: str
) -> None:
    found = direct(nominal, channel, column)
    assert not found.uncalibrated
    assert says in found.why_not


def test_recorded_channel_without_a_way_to_its_column_is_an_error(
    make_scans: MakeScans, nominal: CalibrationSet
) -> None:
    poor = without(nominal, "thrust.toml")
    with pytest.raises(
        CalibrationError, match="column thrust: the channel table has no scale for thrust_load; add a file"
    ):
        calibrate(make_scans(5), poor)
    unfitted = [replace(s, values={n: v for n, v in s.values.items() if n != "thrust_load"}) for s in make_scans(5)]
    assert np.isnan(calibrate(unfitted, poor)["thrust"]).all()  # no load cell, no thrust: nothing was lost


def test_a_voltage_behind_a_divider_is_not_taken_for_the_supply(make_scans: MakeScans, nominal: CalibrationSet) -> None:
    with pytest.raises(CalibrationError, match="column supply_voltage: supply: it is behind a divider"):
        calibrate(make_scans(5), without(nominal, "supply.toml"))


def test_a_column_that_no_single_channel_leads_to_is_an_error(nominal: CalibrationSet) -> None:
    for channels, names in (((), "none"), ((OZONE, replace(OZONE, name="ozone_2")), "ozone, ozone_2")):
        with pytest.raises(CalibrationError, match=f"column ozone of the channel table: its channels are {names};"):
            direct_columns(nominal, (OZONE_COLUMN,), channels)


def test_a_curve_in_another_unit_than_the_column_is_an_error(nominal: CalibrationSet) -> None:
    texts = {
        **nominal.texts,
        "rudder.toml": nominal.texts["rudder.toml"].replace('output_unit = "rad"', 'output_unit = "deg"'),
    }
    with pytest.raises(CalibrationError, match="rudder gives 'deg' and column delta_r is in 'rad'"):
        Calibrator(CalibrationSet.from_texts("odd", texts))


def test_instruments_without_a_file_are_named_in_the_notes(make_scans: MakeScans, nominal: CalibrationSet) -> None:
    flight = calibrate(make_scans(5), without(nominal, "beta_vane.toml"))
    assert np.isnan(flight["beta"]).all()
    assert any("beta_vane was recorded, but calibration set poor has no file" in str(note) for note in flight.notes)
