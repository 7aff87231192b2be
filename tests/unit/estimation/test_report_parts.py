"""Pieces of the report pages against hand-made numbers: folding, rounding, grouping, figures' statistics, flight card."""

from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest

from estimation.report.advice import Unidentified, grouped
from estimation.report.drawing.estimate_figures import ellipse
from estimation.report.drawing.figures import LARGE, picture
from estimation.report.drawing.residual_figures import abscissa, binned, spectrum
from estimation.report.flight_tables import flight_card, mean_wind, notes_table
from estimation.report.page import Page, Section
from estimation.report.tables import (
    SHEET,
    ReportTable,
    cell_label,
    needs_width,
    rounded,
    table_slices,
    table_width,
    value_and_bound,
    word_columns,
)
from groundstation.flight import Flight, Provenance


def table(groups: int, span: int = 3) -> ReportTable:
    """One column of names and `groups` groups of numbers of nine letters."""
    head = ("", *(f"h{i}" for i in range(groups * span)))
    rows = tuple((name, *["-0.123456"] * groups * span) for name in ("Cl_p", "Cn_r"))
    return ReportTable("t", "caption", head, rows, (("", 1), *((f"g{i}", span) for i in range(groups))))


def test_a_narrow_table_is_one_piece() -> None:
    (whole,) = table_slices(table(3))
    assert whole.columns == tuple(range(10))
    assert not whole.wide


@pytest.mark.parametrize("groups", [5, 9, 14])
def test_a_wide_table_is_cut_between_groups_and_each_piece_fits_and_begins_with_the_names(groups: int) -> None:
    wide = table(groups)
    found = table_slices(wide)
    assert all(p.columns[0] == 0 and table_width(wide, p.columns, small=p.wide) <= SHEET for p in found)
    assert [c for p in found for c in p.columns[1:]] == list(range(1, 1 + 3 * groups))
    assert all(sum(span for _, span in p.groups) == len(p.columns) for p in found)
    assert needs_width([table(1), wide])
    assert not needs_width([table(1)])


def test_every_cell_of_the_page_has_its_head_and_failed_ones_are_marked() -> None:
    shown = replace(table(1), failed=frozenset({(1, 2)}))
    page = Page("t", "l", [Section("derivatives", "Derivatives", [shown])]).html()
    assert page.count('data-label="g0 h1"') == 2
    assert page.count('class="fail"') == 1
    assert cell_label(shown, 0) == ""


def test_columns_without_numbers_are_words() -> None:
    mixed = ReportTable("t", "", ("a", "b", "c", "d"), (("x", "-1.2", "pass", ""), ("y", "cannot tell", "FAIL", "")))
    assert word_columns(mixed) == {0, 2}


@pytest.mark.parametrize(
    ("value", "bound", "expected"),
    [
        (0.123456, 0.00346, ("0.1235", "0.0035")),
        (1234.56, 67.0, ("1235", "67")),
        (2.0, None, ("2", "")),
        (-0.00001, 0.02, ("0.000", "0.020")),
    ],
)
def test_numbers_stand_to_the_second_figure_of_their_bound(
    value: float, bound: float | None, expected: tuple[str, str]
) -> None:
    assert rounded(value, bound) == expected


def test_pair_of_nothing_is_empty() -> None:
    assert value_and_bound(None, 1.0) == value_and_bound(float("nan"), 1.0) == ["", ""]


def test_what_one_manoeuvre_would_tell_is_one_row() -> None:
    entries = [
        Unidentified(
            "CY_dr", "ml", ("f1",), "delta_r moved only 0.18 deg rms: this data cannot tell; move it", "rudder", False
        ),
        Unidentified(
            "CY_dr", "ml", ("f2",), "delta_r moved only 0.16 deg rms: this data cannot tell; move it", "rudder", True
        ),
        Unidentified(
            "Cn_dr", "ngn", ("f1",), "delta_r moved only 0.18 deg rms: this data cannot tell; move it", "rudder", False
        ),
        Unidentified("CY_p", "ml", ("f1",), "bound 0.02 is wider than 0.015: this data cannot tell", "aileron", False),
    ]
    rudder, aileron = grouped(entries)
    assert (rudder.parameters, rudder.methods, rudder.where) == (("CY_dr", "Cn_dr"), ("ml", "ngn"), ("f1", "f2"))
    assert rudder.whys == ("delta_r moved only … deg rms",)
    assert rudder.determined_jointly == ("CY_dr",)
    assert aileron.parameters == ("CY_p",)


def test_a_note_of_several_flights_is_said_once() -> None:
    found = notes_table([("f1", "late"), ("f2", "late"), ("f1", "short"), ("f1", "late")])
    assert found is not None
    assert found.rows == (("late", "f1, f2"), ("short", "f1"))
    assert notes_table([]) is None


def test_ellipse_holds_95_percent_of_draws(rng: np.random.Generator) -> None:
    covariance = np.array([[4.0, -1.5], [-1.5, 1.0]])
    border = ellipse((3.0, -2.0), covariance) - [3.0, -2.0]
    draws = rng.multivariate_normal([0.0, 0.0], covariance, size=20_000)

    def radius(points: np.ndarray) -> np.ndarray:
        return np.asarray(np.einsum("ij,jk,ik->i", points, np.linalg.inv(covariance), points))

    assert np.ptp(radius(border)) < 1e-9
    assert np.mean(radius(draws) < radius(border).mean()) == pytest.approx(0.95, abs=0.006)  # four sigma of 20000 draws


def test_spectrum_is_flat_for_white_noise_and_peaks_at_a_tone(rng: np.random.Generator) -> None:
    step, n = 0.05, 4096
    noise = rng.standard_normal(n)
    frequency, density = spectrum(noise, step)
    assert np.mean(density[frequency < 5]) == pytest.approx(np.mean(density[frequency >= 5]), rel=0.15)
    frequency, density = spectrum(noise + 2 * np.sin(2 * np.pi * 3.0 * step * np.arange(n)), step)
    assert frequency[np.argmax(density)] == pytest.approx(3.0, abs=0.08)


def test_bins_show_a_cubic_that_is_left(rng: np.random.Generator) -> None:
    x = rng.uniform(-1, 1, 2000)
    centres, means, errors = binned(x, x**3 + 0.1 * rng.standard_normal(x.size))
    assert np.all(np.diff(centres) > 0)
    assert np.abs(means - centres**3).max() < 0.03
    assert np.abs(means[[0, -1]]).min() > 10 * errors.max()


def circling(wind_north: float, wind_east: float) -> Flight:
    """A level turn at 15 m/s in a steady wind, with a little sideslip and bank."""
    t = np.arange(0.0, 40.0, 0.1)
    flat = np.zeros_like(t)
    psi, beta, phi, alpha = 0.2 * t, flat + 0.05, flat + 0.4, flat + 0.07
    # the plane is level: theta such that the velocity has no vertical part
    theta = np.arctan2(
        np.sin(beta) * np.sin(phi) + np.sin(alpha) * np.cos(beta) * np.cos(phi), np.cos(alpha) * np.cos(beta)
    )
    course = psi + np.arctan2(
        np.sin(beta) * np.cos(phi) - np.sin(alpha) * np.cos(beta) * np.sin(phi),
        np.cos(alpha) * np.cos(beta) * np.cos(theta)
        + (np.sin(beta) * np.sin(phi) + np.sin(alpha) * np.cos(beta) * np.cos(phi)) * np.sin(theta),
    )
    columns = {
        "V": flat + 15.0,
        "alpha": alpha,
        "beta": beta,
        "phi": phi,
        "theta": theta,
        "psi": psi,
        "altitude": flat + 80,
        "vn": 15.0 * np.cos(course) + wind_north,
        "ve": 15.0 * np.sin(course) + wind_east,
        "p_static": flat + 100_000.0,
        "temperature": flat + 293.15,
    }
    return Flight.build("turn", t, columns, provenance=Provenance(aircraft="cdfp"))


def test_flight_card_gives_wind_weather_mass_and_speeds() -> None:
    flight = circling(-3.0, 4.0)  # blows to the south-east: from the north-west
    found = mean_wind(flight)
    assert found is not None
    assert found[0] == pytest.approx(5.0, abs=1e-6)
    assert np.degrees(found[1]) % 360 == pytest.approx(np.degrees(np.arctan2(-4.0, 3.0)) % 360, abs=1e-4)
    card = flight_card([flight])
    row = dict(zip(card.head, card.rows[0], strict=True))
    assert row["wind [m/s]"] == "5.0 from 307°"
    assert row["pressure [hPa]"] == "1000.0"
    assert row["temperature [°C]"] == "20.0"
    assert row["V [m/s]"] == "15.0 (15.0 to 15.0)"
    assert row["mass [kg]"]
    assert row["density [kg/m³]"] == row["date, time [UTC]"] == ""


def test_flight_card_of_an_unknown_aircraft_leaves_its_mass_empty() -> None:
    stranger = replace(circling(0.0, 0.0), provenance=Provenance(aircraft="nobody", detail={"utc_offset_s": 1.7e9}))
    row = dict(zip(flight_card([stranger]).head, flight_card([stranger]).rows[0], strict=True))
    assert row["mass [kg]"] == ""
    assert row["date, time [UTC]"] == "2023-11-14 22:13"


def test_figures_are_vectors_and_stay_small_with_long_records() -> None:
    import base64

    from matplotlib.figure import Figure

    figure = Figure()
    axis = figure.subplots()
    axis.plot(np.random.default_rng(1).standard_normal(60_000), ".")
    axis.set_xlabel("time")
    shown = picture(figure, "f", "caption", LARGE + 1)
    text = base64.b64decode(shown.uri.partition(",")[2])
    assert shown.uri.startswith("data:image/svg+xml")
    assert b"<image" in text  # the dots
    assert len(text) < 400_000


@pytest.mark.parametrize("seed", range(4))
def test_noise_alone_leaves_as_many_bins_outside_as_their_bars_say(seed: int) -> None:
    """A perfect model's residuals of beta against beta: the measured one would bring its own noise to both axes."""
    rng = np.random.default_rng([7, seed])
    time = np.arange(0, 60, 0.05)
    truth = 0.03 * np.sin(1.1 * time)
    measured = truth + rng.normal(0, 0.015, time.size)
    model = SimpleNamespace(outputs=(SimpleNamespace(name="beta", source="beta"),))
    fit = SimpleNamespace(time=time, outputs=truth[:, None])
    flight = Flight.build("f", time, {"beta": measured, "delta_a": truth})
    residual = measured - truth
    x = abscissa(model, fit, flight, "beta")
    _, means, bars = binned(x, residual)
    assert (
        np.sum(np.abs(means) > bars) <= 3
    )  # of ten; one in twenty by the bars, four or more in a thousand such figures
    _, means, bars = binned(measured, residual)
    assert np.sum(np.abs(means) > bars) >= 5
    assert abscissa(model, fit, flight, "delta_a") is flight["delta_a"]
