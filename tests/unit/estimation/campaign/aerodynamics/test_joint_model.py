"""One model over the envelope: its text, the choice of terms by flights held out, and a whole small campaign."""

from collections.abc import Callable
from pathlib import Path

import numpy as np
import pyarrow.parquet as pq
import pytest
from click.testing import CliRunner

from estimation.campaign.aerodynamics.evidence import PooledInformation, superfluous_terms, terms_that_gain
from estimation.campaign.aerodynamics.joint import GlobalModel, global_model
from estimation.campaign.aerodynamics.terms import ConditionTerm, candidates, row_of, terms_of, with_terms
from estimation.campaign.run import CampaignOutcome
from estimation.campaign.tasks import CampaignError
from estimation.estimators.output_error import output_error
from estimation.models import load_model, read_model
from estimation.models.expressions import evaluate
from groundstation.flight import Flight
from sideslip.verbs.match import match
from tests.studies.envelope_model import made_flights, misfit

pytestmark = [
    pytest.mark.timeout(600),
]  # two searches over twelve flights, on a machine that others use

REFERENCE = {"alpha_ref": 0.09, "V_ref": 16.0, "delta_e_ref": -0.02}


def test_terms_stand_wherever_their_derivative_stood() -> None:
    base = load_model("lateral", "cdfp")
    terms = [
        ConditionTerm("Cl_beta", "alpha", 1),
        ConditionTerm("Cl_beta", "V", 2),
        ConditionTerm("Cl_da", "delta_e", 1),
        ConditionTerm("Cn_beta", "beta", 2),
    ]
    model = with_terms(base, terms, REFERENCE).with_starts(
        Cl_beta_alpha=-0.7, Cl_beta_V2=0.3, Cl_da_delta_e=0.2, Cn_beta_beta2=0.25
    )
    assert set(terms_of(model)) == set(terms)
    assert "delta_e" in model.input_names
    assert "Cl_beta_here*beta" in model.definitions["Cl"]
    at = {"alpha": 0.12, "V": 18.0, "delta_e": 0.03, "beta": 0.1}
    symbols = {**model.starts(), **model.constants, **at}
    for name in ("Cl_beta", "Cl_da", "Cn_beta"):
        row = row_of(model, name, model.parameter_names, at)
        said = evaluate(model.definitions[f"{name}_here"], symbols, {})
        assert np.dot(row, [model.starts()[n] for n in model.parameter_names]) == pytest.approx(said)
    assert model.starts()["Cl_beta"] - 0.7 * 0.03 + 0.3 * (18 / 16 - 1) ** 2 == pytest.approx(
        evaluate(model.definitions["Cl_beta_here"], symbols, {})
    )
    assert with_terms(base, [], {}) is base


def test_candidates_heed_what_the_flights_measure_and_the_symmetry() -> None:
    base = load_model("lateral", "cdfp")
    tried = candidates(base, ["delta_e"])
    assert ConditionTerm("Cl_da", "delta_a", 2) in tried
    assert ConditionTerm("Cl_p", "delta_a", 2) not in tried
    assert not any(t.variable == "beta" and t.power == 1 for t in tried)
    assert not any(t.variable == "delta_e" for t in candidates(base, []))
    assert not any(t.derivative.endswith("_0") for t in tried)


def regression(rng: np.random.Generator, slope: float) -> PooledInformation:
    """Flights as linear regressions of 50 samples with noise 1: y = a x0 + slope x1 + 0 x2 + ..., at a = slope = 0."""
    M, g = [], []
    for _ in range(20):
        X = rng.standard_normal((50, 6))
        X[:, 5] = X[:, 1]  # the same under another name
        y = 0.5 * X[:, 0] + slope * X[:, 1] + rng.standard_normal(50)
        M.append(X.T @ X)
        g.append(X.T @ y)
    return PooledInformation(("a", "b", "c", "d", "e", "b_again"), np.array(M), np.array(g))


def test_evidence_takes_the_term_that_is_there_and_its_gain_is_that_of_leaving_flights_out(
    rng: np.random.Generator,
) -> None:
    known = regression(rng, 0.3)
    taken = terms_that_gain(known, ["a"], ["c", "b", "d", "e", "b_again"], 4)
    assert [t.name for t in taken] == ["b"]
    gain = 0.0
    for i in range(20):  # by fits without the flight, written out
        rest = [k for k in range(20) if k != i]
        both, one = [
            np.linalg.solve(known.M[rest][:, :n, :n].sum(axis=0), known.g[rest][:, :n].sum(axis=0)) for n in (2, 1)
        ]
        loss = [
            g @ t - 0.5 * t @ M @ t
            for g, t, M in [(known.g[i][:2], both, known.M[i][:2, :2]), (known.g[i][:1], one, known.M[i][:1, :1])]
        ]
        gain += loss[0] - loss[1]
    assert taken[0].gain == pytest.approx(gain)


def test_evidence_takes_hardly_anything_where_nothing_is() -> None:
    rng = np.random.default_rng(3)
    assert sum(len(terms_that_gain(regression(rng, 0.0), ["a"], ["b", "c", "d", "e"], 4)) for _ in range(40)) <= 2


def test_a_term_that_another_has_made_useless_goes(rng: np.random.Generator) -> None:
    """At the optimum of a, b, c: c is noise, b is there."""
    known = regression(rng, 0.3)
    inside = [0, 1, 2]
    M, g = known.M.sum(axis=0), known.g.sum(axis=0)
    best = np.zeros(6)
    best[inside] = np.linalg.solve(M[np.ix_(inside, inside)], g[inside])
    there = PooledInformation(known.names, known.M, known.g - known.M @ best)
    assert superfluous_terms(there, ["a", "b", "c"], {"b": best[1], "c": best[2]}) == ["c"]


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return tmp_path_factory.mktemp("envelope")


@pytest.fixture(scope="module")
def flights(folder: Path) -> list[Flight]:
    """Twelve flights over speeds of an aircraft whose Cl_beta and Cn_beta change with angle of attack."""
    return made_flights(folder, 12, 4, ("Cl_alpha_beta", "Cn_alpha_beta"))


@pytest.fixture(scope="module")
def found(flights: list[Flight]) -> GlobalModel:
    return global_model(load_model("lateral", "cdfp"), flights[:9])


def test_what_the_aircraft_has_is_chosen_and_flights_held_out_are_better_predicted(
    flights: list[Flight], found: GlobalModel
) -> None:
    """Truth of the simulator: -0.75 and -0.15 per rad2."""
    assert {"Cl_beta_alpha", "Cn_beta_alpha"} <= {g.name for g in found.gains}
    for name, true in (("Cl_beta_alpha", -0.75), ("Cn_beta_alpha", -0.15)):
        assert abs(found.result.values[name] - true) < 4.0 * found.result.std_coloured[name]
    base = load_model("lateral", "cdfp")
    own = [output_error(base, f) for f in flights[:9:4]]
    whole = misfit(found.model, flights[9:], own[0].noise)
    assert all(whole < 0.6 * misfit(o.fitted_model, flights[9:], own[0].noise) for o in own)


def test_too_few_flights_are_refused(flights: list[Flight]) -> None:
    with pytest.raises(CampaignError, match="needs 4 flights"):
        global_model(load_model("lateral", "cdfp"), flights[:3])


def test_a_campaign_leaves_tables_and_a_model_that_match_takes(
    folder: Path, flights: list[Flight], campaign: Callable[..., CampaignOutcome], tmp_path: Path
) -> None:
    out = tmp_path / "out"
    plan = {"flights": [str(folder / "flight00*.csv")], "envelope": True}
    outcome = campaign(plan, out)
    assert any(r["kind"] == "envelope" and "Cn_beta_alpha" in r["text"] for r in outcome.groups)
    rows = pq.read_table(out / "database" / "database.parquet").to_pylist()
    joint = [
        r for r in rows if r["kind"] == "joint" and r["parameter"] == "Cn_beta" and r["along"] == "alpha" and r["flown"]
    ]
    slope = (joint[-1]["estimate"] - joint[0]["estimate"]) / (joint[-1]["alpha"] - joint[0]["alpha"])
    assert slope == pytest.approx(-0.15, rel=0.15)
    assert {r["kind"] for r in rows} == {"pooled", "joint"}
    (model,) = (out / "database").glob("*.toml")
    assert "Cn_beta_alpha" in read_model(model).parameter_names
    low, high = read_model(model).flown["V"]
    assert low < 14.5 < 18.0 < high
    done = CliRunner().invoke(match, [str(model), str(folder / "flight010.csv")])
    assert done.exit_code == 0, done.output
    again = campaign(plan, out)
    assert again.fitted == 0
