"""The drag polar and what follows, on flights whose truth is known: a glide by closed forms, and the second simulator."""

import json
import math
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from click.testing import CliRunner, Result

import sideslip as ss
from estimation.aircraft import Aircraft, PriorDerivative, load_aircraft
from estimation.errors import AircraftError, DataError
from estimation.performance.polar import best_glide, fitted, least_sink
from estimation.performance.samples import all_stretches, usable
from firmware_sim.runs.direct import direct_flights
from firmware_sim.world.scenario import load_scenario
from firmware_sim.world.simulation import derivatives_of
from groundstation.flight import Flight, write_flight
from groundstation.flight.flight import CHANNELS
from sideslip.cli import cli
from tests.studies import second_truth as truth

CD_0, CD_K = 0.03, 0.05
MASS, AREA, G = 6.0, 0.8, 9.80665
CRAFT = Aircraft("glider", 3.0, AREA, 0.27, MASS, math.nan, math.nan, math.nan, 0.0, {"CD_0": PriorDerivative(0.03)})
LIFT = 5.0  # 1/rad


def glide(
    seed: int,
    offset: float = 0.0,
    thrust: float = 0.0,
    lift: tuple[float, float] = (0.25, 0.95),
    seconds: float = 40.0,
    ripple: float = 0.04,
) -> Flight:
    """A slow sweep from fast to slow by closed forms: lift as asked, drag by the polar, noise of good sensors.

    offset: of the vane [rad]; thrust [N], without a column for it.
    """
    rng = np.random.default_rng([seed, 48])
    time = np.arange(0.0, seconds, 0.05)
    CL = (
        lift[0] + (lift[1] - lift[0]) * 0.5 * (1.0 - np.cos(2.0 * np.pi * time / seconds)) + ripple * np.sin(0.9 * time)
    )
    V = np.sqrt(2.0 * MASS * G / (1.1 * AREA * (CL + 0.1)))
    alpha, pressure = (CL - 0.2) / LIFT, 0.5 * 1.1 * V**2 * AREA / MASS
    CD = CD_0 + CD_K * CL**2
    n = time.size
    columns = {
        "ax": pressure * (CL * np.sin(alpha) - CD * np.cos(alpha)) + thrust / MASS + rng.normal(0, 0.05, n),
        "az": -pressure * (CL * np.cos(alpha) + CD * np.sin(alpha)) + rng.normal(0, 0.08, n),
        "alpha": alpha + offset + rng.normal(0, 0.005, n), "V": V + rng.normal(0, 0.1, n), "rho": np.full(n, 1.1),
    }  # fmt: skip
    return Flight.build(f"g{seed}", time, columns)


def run(*words: object) -> Result:
    return CliRunner().invoke(cli, ["performance", *map(str, words)], standalone_mode=False)


def test_closed_forms_of_the_polar() -> None:
    """Best glide where drag is least, least sink where V CD / CL is, both by search; bounds by draws."""
    polar = fitted(all_stretches([usable(glide(1), CRAFT, throttle_off=True)]))
    rng = np.random.default_rng(1)

    def searched(c0: float, k: float) -> tuple[float, float, float, float]:
        CL = np.linspace(0.05, 3.0, 20001)
        V = np.sqrt(2.0 * MASS * G / (1.1 * AREA * CL))
        ratio = CL / (c0 + k * CL**2)
        sink = V / ratio
        return ratio.max(), V[ratio.argmax()], sink.min(), V[sink.argmin()]

    glided, sinking = best_glide(polar, CRAFT), least_sink(polar, CRAFT)
    told = (glided["ratio"], glided["speed"], sinking["sink"], sinking["speed"])
    for number, by_search in zip(told, searched(*polar.values[:2]), strict=True):
        assert number.estimate == pytest.approx(by_search, rel=1e-3)
    draws = np.array([searched(*d) for d in rng.multivariate_normal(polar.values[:2], polar.covariance[:2, :2], 400)])
    for number, spread in zip(told, draws.std(axis=0), strict=True):
        assert number.std == pytest.approx(spread, rel=0.2)
    assert sinking["power"].estimate == pytest.approx(sinking["sink"].estimate * MASS * G)


@pytest.mark.parametrize("offset", [0.0, math.radians(0.4)])
def test_bounds_hold_the_truth(offset: float) -> None:
    """Over 60 seeds, with a vane that is right or off by 0.4 deg: 90 to 99 % and not more than one seed beyond."""
    inside = {"CD_0": 0, "CD_k": 0, "ratio": 0}
    ratio = 0.5 / math.sqrt(CD_0 * CD_K)
    for seed in range(60):
        polar = fitted(all_stretches([usable(glide(seed, offset), CRAFT, throttle_off=True)]))
        for name, number, true in (("CD_0", polar["CD_0"], CD_0), ("CD_k", polar["CD_k"], CD_K),
                                   ("ratio", best_glide(polar, CRAFT)["ratio"], ratio)):  # fmt: skip
            low, high = number.ends
            inside[name] += low <= true <= high
        assert polar["CD_k"].std < 0.1 * CD_K
    assert all(54 <= count <= 60 for count in inside.values()), inside


def test_bounds_hold_the_truth_of_the_second_simulator() -> None:
    """Thrust measured, gusts, sensors noisy: three flights at three speeds, 16 sets: 14 inside, where bounds of half the size
    would leave 14 or more with a chance of 4 %."""
    flown = truth.fly(
        [truth.Request(700 + 3 * i + j, 13.0 + 3.0 * j, manoeuvres="longitudinal") for i in range(16) for j in range(3)]
    )
    inside = {"CD_0": 0, "CD_k": 0}
    for i in range(16):
        flights = [Flight.build(f"f{j}", c.pop("time"), c) for j, c in enumerate(flown[3 * i : 3 * i + 3])]
        polar = fitted(all_stretches([usable(f, load_aircraft("cdfp"), throttle_off=False) for f in flights]))
        for name in inside:
            low, high = polar[name].ends
            inside[name] += low <= truth.TRUE_DERIVATIVES[name] <= high
    assert all(count >= 14 for count in inside.values()), inside


def test_thrust_that_is_unknown_and_not_off_is_refused() -> None:
    flight = glide(3, thrust=4.0)
    with pytest.raises(DataError, match="thrust is unknown, and nothing says that the throttle was off"):
        usable(flight, CRAFT, throttle_off=False)
    with pytest.raises(DataError, match="throttle is never closed"):
        usable(flight.with_columns(throttle=np.full(len(flight), 0.4)), CRAFT, throttle_off=False)


def test_thrust_that_somebody_assumed_is_not_known() -> None:
    flight = glide(3, thrust=4.0).with_columns(thrust=np.full(800, 4.0))
    for kind, told in (("computed", "thrust computed"), ("assumed", "")):
        stated = replace(flight.provenance, detail={CHANNELS: {"thrust": {"from": "x", "kind": kind}}})
        imported = replace(flight, provenance=stated)
        if told:
            assert usable(imported, CRAFT, throttle_off=False).thrust == told
        else:
            with pytest.raises(DataError, match="thrust is unknown"):
                usable(imported, CRAFT, throttle_off=False)


def test_measured_thrust_is_taken_off() -> None:
    flight = glide(4, thrust=4.0)
    known = flight.with_columns(thrust=np.full(len(flight), 4.0))
    right = fitted(all_stretches([usable(known, CRAFT, throttle_off=False)]))
    low, high = right["CD_0"].ends
    assert low < CD_0 < high
    wrong = fitted(all_stretches([usable(flight, CRAFT, throttle_off=True)]))
    assert not wrong["CD_0"].ends[0] < CD_0 < wrong["CD_0"].ends[1]


def test_only_what_is_flown_with_the_throttle_closed_counts_and_not_the_second_after() -> None:
    flight = glide(5)
    throttle = np.where((flight.time > 10.0) & (flight.time < 30.0), 0.0, 0.5)
    found = usable(flight.with_columns(throttle=throttle), CRAFT, throttle_off=False)
    assert found.used == pytest.approx(19.0 * 20, abs=2)
    assert found.thrust == "throttle closed"


def test_what_is_missing_is_said() -> None:
    flight = glide(6)
    bare = Flight.build("bare", flight.time, {n: flight[n] for n in ("V", "ax", "az", "rho")})
    with pytest.raises(DataError, match="alpha, which it has not; 'sideslip reconstruct'"):
        usable(bare, CRAFT, throttle_off=True)
    with pytest.raises(AircraftError, match=r"mass\.mass"):
        ss.performance(flight, aircraft=CRAFT.with_values(mass=math.nan), throttle_off=True)


def test_flights_at_one_lift_cannot_tell_and_say_what_to_fly(tmp_path: Path) -> None:
    answer = ss.performance(glide(7, lift=(0.5, 0.5), seconds=8.0, ripple=0.0), aircraft=CRAFT, throttle_off=True)
    assert not answer.passed
    assert "cannot be told" in answer.status
    assert answer.to_json()["best_glide"] is None
    assert answer.to_json()["curve"] == []
    answer.save(tmp_path / "p.png")


def test_what_lies_beyond_the_lift_flown_is_named() -> None:
    """Least sink is at CL 1.34 here: beyond 1.0 the parabola alone says it, and the wing may be stalled."""
    answer = ss.performance(glide(10), aircraft=CRAFT, throttle_off=True)
    assert answer.least_sink["CL"].estimate == pytest.approx(math.sqrt(3 * CD_0 / CD_K), rel=0.1)
    assert answer.status.endswith("least sink beyond them, by the parabola alone")
    said = answer.to_json()
    assert (said["best_glide"]["flown"], said["least_sink"]["flown"]) == (True, False)
    wide = ss.performance(glide(10, lift=(0.25, 1.5)), aircraft=CRAFT, throttle_off=True)
    assert "beyond" not in wide.status
    assert wide.to_json()["least_sink"]["flown"]


def test_a_steady_wind_changes_nothing() -> None:
    """The simulator's aircraft in 9 m/s across its path: lift and drag are those in the air."""
    scenarios = [
        load_scenario("longitudinal").altered(
            flight={"duration_s": 30.0, "speed_m_s": speed}, wind={"speed_m_s": 9.0, "from_deg": 130.0}
        )
        for speed in (14.0, 18.0)
    ]
    flown = direct_flights(scenarios, [31, 32])
    flights = [Flight.build(f"w{i}", c.pop("time"), c) for i, c in enumerate(flown)]
    polar = fitted(all_stretches([usable(f, load_aircraft("cdfp"), throttle_off=False) for f in flights]))
    true = derivatives_of(scenarios[0], 31)
    for name in ("CD_0", "CD_k"):
        assert abs(polar[name].estimate - true[name]) < 3 * polar[name].std
        assert polar[name].std < 0.1 * true[name]


def test_a_throttle_that_never_closes_is_told_with_its_least() -> None:
    flight = glide(11)
    with pytest.raises(DataError, match=r"at least 0\.06 of 1.*--throttle-off with --segments"):
        usable(flight.with_columns(throttle=np.full(len(flight), 0.06)), CRAFT, throttle_off=False)


def test_the_verb_says_what_python_says(tmp_path: Path) -> None:
    file = tmp_path / "g.csv"
    write_flight(glide(8), file)
    (tmp_path / "a.toml").write_text(f'name = "glider"\n[geometry]\narea = {AREA}\n[mass]\nmass = {MASS}\n')
    files = ("--json", tmp_path / "p.json", "--figure", tmp_path / "p.svg", "--report", tmp_path / "page")
    done = run(file, "--aircraft", tmp_path / "a.toml", "--throttle-off", *files)
    assert done.return_value == 0, done.output
    answer = ss.performance(file, aircraft=tmp_path / "a.toml", throttle_off=True)
    said = json.loads((tmp_path / "p.json").read_text())
    assert said == json.loads(json.dumps(answer.to_json()))
    assert answer.summary() in done.output
    assert (tmp_path / "p.svg").stat().st_size > 5000
    assert (tmp_path / "page" / "index.html").is_file()
    sinks = [p["sink"]["estimate"] for p in said["curve"]]
    powers = [p["power"]["estimate"] for p in said["curve"]]
    np.testing.assert_allclose(powers, np.array(sinks) * MASS * G)
    assert said["best_glide"]["ratio"]["low"] < 0.5 / math.sqrt(CD_0 * CD_K) < said["best_glide"]["ratio"]["high"]
    assert list(answer.to_pandas()["V"]) == [p["V"] for p in said["curve"]]
