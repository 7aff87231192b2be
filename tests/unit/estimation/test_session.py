"""A session of several methods and flights, proof of match, and the two verbs."""

import json
import math
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from click.testing import CliRunner

from estimation.aircraft import load_aircraft
from estimation.answers.estimates import session_lines
from estimation.errors import EstimationError
from estimation.models import load_model, write_model
from estimation.prepare.stretches import select_segments
from estimation.session import runner
from estimation.session.evidence import parameter_scatter
from estimation.session.proof_of_match import predict_flight
from estimation.signals.goodness_of_fit import autocorrelation, channel_fit
from groundstation.flight import Flight, write_flight
from sideslip.verbs.estimate import estimate
from sideslip.verbs.match import match
from tests.support.paths import ROOT
from tests.unit.estimation.truth import STRONG, TRUE

LATERAL = load_model("lateral", "cdfp")


def test_theil_parts_add_to_one_and_mean_what_they_say() -> None:
    t = np.linspace(0, 20, 400)
    z = np.sin(t)
    for y, part in ((z + 0.3, "theil_bias"), (z.mean() + 1.5 * (z - z.mean()), "theil_variance")):
        fit = channel_fit(z, y)
        assert fit.theil_bias + fit.theil_variance + fit.theil_covariance == pytest.approx(1.0)
        assert getattr(fit, part) == pytest.approx(1.0, abs=1e-9)
    perfect = channel_fit(z, z)
    assert (perfect.r2, perfect.theil, perfect.rms) == (1.0, 0.0, 0.0)
    assert channel_fit(z, np.full(400, z.mean())).r2 == pytest.approx(0.0)
    assert math.isnan(channel_fit(np.full(400, np.nan), z).r2)


def test_whiteness_knows_white_from_coloured() -> None:
    rng = np.random.default_rng(1)
    white = rng.normal(size=2000)
    coloured = np.convolve(white, np.ones(10) / 10, "same")
    assert channel_fit(white, np.zeros(2000)).whiteness > 0.92
    assert channel_fit(coloured, np.zeros(2000)).whiteness < 0.9
    assert autocorrelation(white, 5)[0] == 1.0


def test_scatter_says_when_bounds_are_too_small(made_flights: list[Flight]) -> None:
    session = runner.estimate(LATERAL, made_flights[:2], load_aircraft("cdfp"), ["ml"])
    results = [f.results["ml"] for f in session.flights]
    honest = parameter_scatter(results)["Cl_p"]
    assert honest.text == ""
    from dataclasses import replace

    small = [
        replace(r, parameters={n: replace(e, std_coloured=e.std_coloured / 500) for n, e in r.parameters.items()})
        for r in results
    ]
    assert "too small" in parameter_scatter(small)["Cl_p"].text


def test_a_joint_estimate_of_one_record_given_twice_is_refused(made_flights: list[Flight]) -> None:
    one, other = made_flights[:2]
    again = one.part(slice(20, None), "again")
    with pytest.raises(EstimationError, match=f"again is of the same record as {one.name}, .* give every flight once"):
        runner.estimate(LATERAL, [one, other, again], load_aircraft("cdfp"), ["ls"], joint=True)
    assert len(runner.estimate(LATERAL, [one, again], load_aircraft("cdfp"), ["ls"]).flights) == 2


def test_session_json_has_the_promised_names(made_flights: list[Flight]) -> None:
    session = runner.estimate(LATERAL, made_flights[:2], load_aircraft("cdfp"), ["ml", "ls"], joint=True)
    data = json.loads(json.dumps(session.to_json(), allow_nan=False))
    assert set(data) >= {"version", "aircraft", "model", "status", "flights", "mean", "joint", "collinear"}
    ml = data["flights"][0]["methods"]["ml"]
    assert set(ml) >= {"converged", "status", "iterations", "cost", "R", "parameters", "fit"}
    assert set(ml["parameters"]["CY_beta"]) >= {"estimate", "std", "std_coloured", "identifiable"}
    assert set(ml["fit"]["beta"]) >= {"r2", "theil", "rms"}
    assert data["mean"]["ml"]["Cl_p"].keys() == {"mean", "std"}
    assert data["joint"]["ml"]["parameters"]["Cl_p"]["estimate"] == pytest.approx(TRUE["Cl_p"], rel=0.05)


def test_proof_of_match_of_the_right_and_a_wrong_model(made_flights: list[Flight]) -> None:
    right = predict_flight(LATERAL.with_starts(TRUE), made_flights[0])
    wrong = predict_flight(LATERAL.with_starts({**TRUE, "Cn_beta": 0.013, "Cl_da": -0.06}), made_flights[0])
    assert right.converged
    assert all(f.r2 > 0.85 for f in right.fit.values())
    assert all(f.theil < 0.2 for f in right.fit.values())
    assert wrong.fit["beta"].theil > 2 * right.fit["beta"].theil
    biased = made_flights[0].with_columns(p=made_flights[0]["p"] + 0.05)
    freed = predict_flight(LATERAL.with_starts(TRUE).with_biases("p"), biased, free=["bias_p"])
    assert freed.result.parameters["bias_p"].estimate == pytest.approx(0.05, abs=0.005)


def test_segments_option(made_flights: list[Flight]) -> None:
    cut = select_segments(made_flights[0], "2:8,10:15")
    assert [round(float(cut.time[s.start]), 2) for s in cut.segments] == [2.0, 10.0]
    for text in ("2-8", "8:2", "90:95"):
        with pytest.raises(EstimationError, match="--segments"):
            select_segments(made_flights[0], text)


def test_estimate_and_match_from_the_command_line(made_flights: list[Flight], tmp_path: Path) -> None:
    paths = []
    for flight in made_flights[:2]:
        paths.append(str(tmp_path / f"{flight.name}.csv"))
        write_flight(flight, paths[-1])
    out: Any = CliRunner().invoke(
        estimate,
        [
            *paths,
            "--aircraft",
            "cdfp",
            "--joint",
            "--json",
            str(tmp_path / "e.json"),
            "--figure",
            str(tmp_path / "f.png"),
        ],
        standalone_mode=False,
    )
    assert out.exception is None
    assert out.return_value == 0
    assert "joint over 2 flights" in out.output
    assert (tmp_path / "f.png").stat().st_size > 20_000
    data = json.loads((tmp_path / "e.json").read_text())
    found = {n: e["estimate"] for n, e in data["joint"]["ml"]["parameters"].items()}
    write_model(LATERAL.with_starts(found), tmp_path / "m.toml")
    for model, status in ((LATERAL.with_starts(found), 0), (LATERAL.with_starts({**found, "Cn_beta": 0.002}), 1)):
        write_model(model, tmp_path / "m.toml")
        out = CliRunner().invoke(
            match, [str(tmp_path / "m.toml"), paths[0], "--json", str(tmp_path / "m.json")], standalone_mode=False
        )
        assert out.exception is None
        assert out.return_value == status
    entry = json.loads((tmp_path / "m.json").read_text())["flights"][0]
    assert set(entry["fit"]["beta"]) >= {"r2", "theil", "rms"}
    assert all(abs(found[n] / TRUE[n] - 1) < 0.1 for n in STRONG)


def test_light_imports() -> None:
    """The simulator reads an aircraft without a numerical library; estimating needs neither torch nor matplotlib."""
    import subprocess
    import sys

    code = (
        "import sys, estimation.aircraft as a; a.load_aircraft('cdfp');"
        "assert not {'casadi', 'scipy', 'torch', 'matplotlib'} & set(sys.modules);"
        "import estimation.estimators.output_error, estimation.session.runner;"
        "assert not {'torch', 'matplotlib', 'scipy', 'rerun'} & set(sys.modules)"
    )
    subprocess.run([sys.executable, "-c", code], check=True, cwd=ROOT)


def test_brief_prints_the_numbers_that_the_data_could_tell(made_flights: list[Flight]) -> None:
    session = runner.estimate(LATERAL, made_flights[:1], load_aircraft("cdfp"), ["ml"])
    _, ended, numbers, recommended = session_lines(session, brief=True)
    assert "recommended: ml: " in recommended
    assert "ml: " in ended
    found = session.flights[0].results["ml"].parameters
    for name, e in found.items():
        assert (f"{name} " in numbers) is e.identifiable
    value = float(numbers.split("Cl_p ")[1].split()[0])
    assert value == pytest.approx(found["Cl_p"].estimate, abs=0.05 * found["Cl_p"].std_coloured)


@pytest.mark.parametrize("seed", range(3))
def test_a_perfect_model_passes_whatever_the_noise_of_a_channel_and_a_wrong_one_does_not(seed: int) -> None:
    """Theil's coefficient of noise alone is sigma / (rms z + rms y), by hand: 0.4 here, above the limit of a clean channel."""
    rng = np.random.default_rng([40, seed])
    t = np.arange(0, 40, 0.05)
    y = 0.2 * np.sin(0.9 * t)
    sigma = 1.0 * y.std()
    z = y + rng.normal(0, sigma, t.size)
    perfect = channel_fit(z, y)
    assert perfect.noise == pytest.approx(sigma / (np.sqrt(np.mean(z**2)) + np.sqrt(np.mean(y**2))), rel=0.15)
    assert perfect.theil > 0.3
    assert perfect.matches(0.3)
    assert not channel_fit(z, -0.5 * y).matches(0.3)
    clean = channel_fit(y, 0.4 * y)  # Theil 0.6 / 1.4 = 0.43 without any noise
    assert clean.noise < 0.001
    assert not clean.matches(0.3)
