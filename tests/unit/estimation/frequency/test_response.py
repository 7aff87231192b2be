"""Frequency responses against the transfer function of a linear aircraft, and against scipy's own estimate."""

import numpy as np
import pytest
from scipy import signal

from estimation.errors import DataError
from estimation.frequency import spectra
from estimation.frequency.records import collect
from estimation.frequency.response import FrequencyResponse, ResponseOptions, frequency_response
from groundstation.flight import Flight
from groundstation.flight.errors import MissingColumnError
from tests.unit.estimation.frequency.linear_aircraft import DUTCH_ROLL, ROLL, Case, Plant, fly

ALONE = ResponseOptions(with_=(), points=24)


def off(r: FrequencyResponse, plant: Plant) -> tuple[np.ndarray, np.ndarray]:  # type: ignore[type-arg]
    """Errors of magnitude and phase over the random error told."""
    H = plant.at(r.omega)
    return (r.magnitude - np.abs(H)) / r.std, np.angle(r.H / H) / r.std_phase


@pytest.mark.parametrize(
    ("plant", "case"),
    [
        (ROLL, Case(40.0)),
        (ROLL, Case(40.0, kind="doublets", colour=0.8)),
        (DUTCH_ROLL, Case(60.0, kind="chirp", colour=0.5)),
        (DUTCH_ROLL, Case(40.0, noise=0.02, colour=0.8)),
    ],
)
def test_the_error_told_covers_the_truth(plant: Plant, case: Case) -> None:
    """Seeds are few and neighbouring points share windows, so that 95 % may come out as 92; a wrong error is far off."""
    flown = [fly({"delta_a": plant}, "p", case, np.random.default_rng(seed)) for seed in range(4)]
    found = [off(frequency_response(f, "delta_a", "p", ALONE), plant) for f in flown]
    for each in zip(*found, strict=True):
        together = np.concatenate(each)
        assert together.size > 40
        assert np.mean(np.abs(together) < 1.96) >= 0.92
        assert np.sqrt(np.mean(together**2)) > 0.4  # an error too wide is no answer either


def test_scipy_says_the_same_for_one_window_length() -> None:
    flight = fly({"delta_a": ROLL}, "p", Case(15.5, noise=0.05), np.random.default_rng(2))
    stretch = collect([flight], "delta_a", "p", ()).stretches[0]
    length, size = 5.0, 101
    starts = spectra.windows(stretch, length)[1]
    hop = int(starts[1] - starts[0])
    assert set(np.diff(starts)) == {hop}
    taper = spectra.tapers(size)[0]

    def plain(x: np.ndarray) -> np.ndarray:  # type: ignore[type-arg]
        return np.asarray(x - np.sum(taper * x, axis=-1, keepdims=True) / taper.sum())

    same = {"fs": 20.0, "window": taper, "nperseg": size, "noverlap": size - hop, "detrend": plain}
    frequency, xy = signal.csd(stretch.x[:, 0], stretch.y, **same)
    xx = signal.welch(stretch.x[:, 0], **same)[1]
    g2 = signal.coherence(stretch.x[:, 0], stretch.y, **same)[1]
    spacing = 2 * np.pi * float(frequency[1])
    grid = spectra.FrequencyGrid(2 * spacing, spacing, np.arange(18))
    parts = spectra._transforms(stretch, length, grid, spectra.MOST_WINDOWS)
    ours = spectra._solved(parts.X[:1], parts.Y, parts.R, length)
    assert ours is not None
    np.testing.assert_allclose(grid.omega / 2 / np.pi, frequency[2:20])
    np.testing.assert_allclose(ours.H, (xy / xx)[2:20], rtol=1e-8)
    np.testing.assert_allclose(ours.coherence, g2[2:20], rtol=1e-8)


def test_the_error_is_that_of_bendat_and_piersol_for_windows_apart() -> None:
    """Windows that share nothing, one input: |H| sqrt(1 - g2) / (|g| sqrt(2 (n - 1))), with Student's factor."""
    flight = fly({"delta_a": ROLL}, "p", Case(60.0, noise=0.05), np.random.default_rng(3))
    stretch = collect([flight], "delta_a", "p", ()).stretches[0]
    grid = spectra.FrequencyGrid(6.0, 3.0, np.arange(5))
    parts = spectra._transforms(stretch, 5.0, grid, 12)
    apart = np.diag(np.diag(parts.R))
    ours = spectra._solved(parts.X[:1], parts.Y, apart, 5.0)
    assert ours is not None
    n, g2 = len(apart), ours.coherence
    expected = np.abs(ours.H) * np.sqrt((1 - g2) / g2 / (2 * (n - 1)))
    from scipy.stats import t

    np.testing.assert_allclose(ours.std, expected * t.ppf(0.975, 2 * (n - 1)) / 1.96, rtol=1e-9)


def test_the_share_of_a_second_input_is_taken_off() -> None:
    """The rudder moves with the aileron: without it in the sum, its share is taken for the aileron's."""
    plants = {"delta_a": ROLL, "delta_r": Plant((-12.0,), (1.0, 3.0))}
    flight = fly(plants, "p", Case(60.0), np.random.default_rng(4), shared=0.8)
    both, alone = frequency_response(flight, "delta_a", "p"), frequency_response(flight, "delta_a", "p", ALONE)
    assert both.inputs == ("delta_a", "delta_r")
    assert np.mean(np.abs(off(both, ROLL)[0]) < 1.96) >= 0.92
    wrong = [float(np.median(np.abs(r.H / ROLL.at(r.omega) - 1))) for r in (both, alone)]
    assert wrong[0] < 0.1
    assert wrong[1] > 0.4
    assert np.median(both.coherence) > np.median(alone.coherence) + 0.05
    second = frequency_response(flight, "delta_r", "p")
    assert np.mean(np.abs(off(second, plants["delta_r"])[0]) < 1.96) >= 0.92


def test_no_window_crosses_a_gap() -> None:
    """A jump of a radian between two stretches would drown everything."""
    flight = fly({"delta_a": ROLL}, "p", Case(60.0), np.random.default_rng(5))
    time, p = flight.time.copy(), flight["p"].copy()
    time[600:] += 20.0
    p[600:] += 1.0
    gapped = Flight.build("gapped", time, {"delta_a": flight["delta_a"], "p": p})
    r = frequency_response(gapped, "delta_a", "p", ALONE)
    assert np.sqrt(np.mean(off(r, ROLL)[0] ** 2)) < 1.5  # one seed, points that share windows
    assert np.median(np.abs(r.H / ROLL.at(r.omega) - 1)) < 0.1
    assert any("2 stretches" in n for n in r.notes)
    assert max(r.windows) <= 30.0
    holes = p.copy()
    holes[300:400] = np.nan
    holes[100] = np.nan  # one sample alone is bridged
    r = frequency_response(gapped.with_columns(p=holes), "delta_a", "p", ALONE)
    assert np.sqrt(np.mean(off(r, ROLL)[0] ** 2)) < 1.5
    assert np.median(np.abs(r.H / ROLL.at(r.omega) - 1)) < 0.1
    assert any("3 stretches" in n for n in r.notes)


def test_several_flights_say_more() -> None:
    flights = [fly({"delta_a": ROLL}, "p", Case(40.0, noise=0.03), np.random.default_rng(s)) for s in (6, 7, 8)]
    one, all_ = (frequency_response(f, "delta_a", "p", ALONE) for f in (flights[0], flights))
    assert np.median(all_.std / all_.magnitude) < 0.75 * np.median(one.std / one.magnitude)
    assert np.mean(np.abs(off(all_, ROLL)[0]) < 1.96) >= 0.92


def test_what_is_not_coherent_is_left_out() -> None:
    """Noise ten times the answer above the roll mode: those points go, those that stay are right."""
    flight = fly({"delta_a": Plant((8.0,), (1.0, 0.8))}, "p", Case(60.0, noise=0.15), np.random.default_rng(9))
    r = frequency_response(flight, "delta_a", "p", ALONE)
    assert r.left_out
    assert sum(f > r.omega[-1] for f, _ in r.left_out) > 0.5 * len(r.left_out)
    assert np.sqrt(np.mean(off(r, Plant((8.0,), (1.0, 0.8)))[0] ** 2)) < 1.5
    assert np.all(r.coherence > 0.0)
    assert np.all(r.std < r.magnitude)
    unrelated = flight.with_columns(q=np.random.default_rng(1).normal(size=len(flight)))
    with pytest.raises(DataError, match="q does not follow delta_a anywhere"):
        frequency_response(unrelated, "delta_a", "q", ALONE)


def test_uneven_samples() -> None:
    """Scans of a 20 Hz grid of which every third never came: 50 and 100 ms apart, as the radio sends them."""
    flight = fly({"delta_a": ROLL}, "p", Case(60.0, kind="doublets"), np.random.default_rng(10))
    keep = np.arange(len(flight)) % 3 != 2
    r = frequency_response(flight.part(keep), "delta_a", "p", ResponseOptions((), (0.2, 1.5), 24))
    assert np.median(np.abs(r.H / ROLL.at(r.omega) - 1)) < 0.05
    assert np.sqrt(np.mean(off(r, ROLL)[0] ** 2)) < 1.5


def closed_loop(gain: float, rng: np.random.Generator) -> Flight:
    """p' = -5 p + 8 u + w, a pilot who answers p after 0.15 s: u = sweep - gain p."""
    h, late, count = 0.0025, 60, 16001
    sweep = 0.05 * np.sin(np.cumsum(np.geomspace(0.8, 12.0, count)) * h)
    p, u, w = np.zeros(count), np.zeros(count), 0.0
    kicks = 0.3 * np.sqrt(2 * h / 0.5) * rng.normal(size=count)
    for k in range(count - 1):
        w += -h / 0.5 * w + kicks[k]
        u[k] = sweep[k] - gain * p[max(k - late, 0)]
        p[k + 1] = p[k] + h * (-5 * p[k] + 8 * u[k] + w)
    t = np.arange(count) * h
    sensed = {"delta_a": u[::20] + 5e-4 * rng.normal(size=801), "p": p[::20] + 3e-3 * rng.normal(size=801)}
    return Flight.build("held", t[::20], sensed)


def test_feedback_is_told_and_its_absence_is_not() -> None:
    rng = np.random.default_rng(12)
    closed = frequency_response(closed_loop(0.3, rng), "delta_a", "p", ALONE)
    assert any("follows p" in n and "loop was closed" in n for n in closed.notes)
    for _ in range(3):
        assert not any("closed" in n for n in frequency_response(closed_loop(0.0, rng), "delta_a", "p", ALONE).notes)


def test_noise_of_the_input_is_told() -> None:
    rng = np.random.default_rng(13)
    flight = fly({"delta_a": ROLL}, "p", Case(60.0), rng)
    noisy = flight.with_columns(delta_a=flight["delta_a"] + 0.02 * rng.normal(size=len(flight)))
    assert any("noise of delta_a" in n for n in frequency_response(noisy, "delta_a", "p", ALONE).notes)


def test_a_spike_does_not_count_and_nonsense_is_refused() -> None:
    flight = fly({"delta_a": ROLL}, "p", Case(40.0), np.random.default_rng(15))
    p = flight["p"].copy()
    p[333] = 1e9
    plain, spiked = (frequency_response(f, "delta_a", "p", ALONE) for f in (flight, flight.with_columns(p=p)))
    np.testing.assert_allclose(spiked.H, plain.H, rtol=0.05)
    assert any("wild value" in n for n in spiked.notes)
    with pytest.raises(DataError, match=r"p reaches 1e\+300, which nothing that is measured does"):
        frequency_response(flight.with_columns(p=1e300 * np.sign(flight["p"])), "delta_a", "p")


def test_unusable_requests_are_one_sentence() -> None:
    flight = fly({"delta_a": ROLL}, "p", Case(30.0), np.random.default_rng(14))
    still = flight.with_columns(delta_a=1e-3 * np.random.default_rng(1).normal(size=len(flight)))
    with pytest.raises(DataError, match=r"delta_a moved only .* so there is no response to it; fly a frequency sweep"):
        frequency_response(still, "delta_a", "p")
    with pytest.raises(DataError, match="delta_a moved only 0 rms"):
        frequency_response(flight.with_columns(delta_a=np.full(len(flight), 0.1)), "delta_a", "p")
    with pytest.raises(MissingColumnError, match="delta_r"):
        frequency_response(flight, "delta_r", "p")
    with pytest.raises(DataError, match="cannot be input and output at once"):
        frequency_response(flight, "p", "p")
    with pytest.raises(DataError, match="output p stands still"):
        frequency_response(flight.with_columns(p=np.zeros(len(flight))), "delta_a", "p")
    with pytest.raises(DataError, match="too few windows"):
        frequency_response(flight.part(slice(0, 40)), "delta_a", "p")
    for band in ((1.0, 0.5), (0.5, 50.0), (0.01, 1.0), (float("nan"), 1.0)):
        with pytest.raises(DataError, match="band"):
            frequency_response(flight, "delta_a", "p", ResponseOptions(band=band))
    with pytest.raises(DataError, match="windows must be positive"):
        frequency_response(flight, "delta_a", "p", ResponseOptions(windows=(100.0,)))
    with pytest.raises(DataError, match="too few windows"):  # the long window is one window only, the short too short
        frequency_response(flight, "delta_a", "p", ResponseOptions(windows=(30.0, 2.0), band=(0.1, 0.4)))
    with pytest.raises(DataError, match="give 2 to 2000"):
        frequency_response(flight, "delta_a", "p", ResponseOptions(points=1))
