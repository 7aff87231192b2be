"""Flights without vanes: compared in what was measured, driven by what was found, with its level left open."""

from collections.abc import Mapping
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from estimation.engine.kernel import Array
from estimation.errors import GapError
from estimation.gap.criteria import AS_SET
from estimation.gap.effects import catalogue
from estimation.gap.records.candidate_model import levels, stamped_attitudes, with_levels, with_nuisance
from estimation.gap.records.channels import as_measured, compared, not_compared
from estimation.gap.workflow import Options, _with_estimated_starts, run_gap
from estimation.models.base import ParameterRole
from estimation.models.load import load_model
from groundstation.flight import RECONSTRUCTED, Flight, Provenance, read_flight
from tests.studies import second_truth as truth
from tests.studies.gap_benchmark import flights, requests
from tests.studies.gap_vaneless import reconstructed

TIME: Array = np.arange(100) / 50.0
COLUMNS = ("beta", "p", "r", "phi", "ay", "V", "alpha", "theta", "q", "rho", "delta_a", "delta_r")
LATERAL = load_model("lateral", "cdfp")


def flown(
    name: str, found: Mapping[str, float] | None = None, without: tuple[str, ...] = (), hz: float = 0.0
) -> Flight:
    """found: column that a reconstruction made -> its uncertainty. hz: of the attitude in its log."""
    columns = {c: 1.0 + k + 0.01 * np.sin(TIME) for k, c in enumerate(COLUMNS) if c not in without}
    columns |= {f"{c}_std": np.full(TIME.size, std) for c, std in (found or {}).items()}
    detail: dict[str, object] = {RECONSTRUCTED: {"columns": list(found)}} if found else {}
    if hz:
        detail["native_hz"] = {"phi": hz}
    return Flight.build(name, TIME, columns, provenance=Provenance(detail=detail))


def test_a_model_is_not_compared_in_angles_that_some_flight_did_not_measure() -> None:
    vane, found, bare = flown("a"), flown("b", {"beta": 0.02, "alpha": 0.03}), flown("c", without=("beta",))
    assert compared(LATERAL, [vane]) == (LATERAL, [])
    assert not_compared(LATERAL, LATERAL) == ""
    said = {"b": "b: beta found from the motion: not compared", "c": "c: beta not measured: not compared"}
    for other in (found, bare):
        model, notes = compared(LATERAL, [vane, other])
        assert model.output_names == ("p", "r", "phi", "ay")
        assert model.input_names == LATERAL.input_names
        assert notes == [said[other.name]]
        assert not_compared(LATERAL, model) == "Not measured, and so not compared: beta."


def test_a_reconstruction_saved_as_a_table_is_none_of_a_vane(tmp_path: Path) -> None:
    """A CSV keeps no provenance: of an autopilot's log reconstructed and saved so a vane ahead of the CG had been named."""
    found = flown("b", {"beta": 0.02, "alpha": 0.03})
    wind = {c: np.full(TIME.size, 2.0) for c in ("wind_n", "wind_e", "wind_d")}
    read = read_flight(found.with_columns(**wind).save(tmp_path / "b.csv"))
    assert read.reconstructed == ("alpha", "beta")
    assert read_flight(found.save(tmp_path / "c.csv")).reconstructed == (), "a width of somebody's own vane"


def test_a_level_is_left_open_for_every_flight_as_widely_as_the_reconstruction_says() -> None:
    given = [flown("a", {"V": 0.3, "alpha": 0.02}), flown("b", {"V": 0.4, "alpha": 0.0}), flown("c")]
    wide = levels(LATERAL, given)
    assert wide == pytest.approx({"V": np.sqrt(0.5 * (0.09 + 0.16)), "alpha": 0.02})
    model = with_levels(LATERAL, wide)
    for name in wide:
        level = model.parameter(f"level_{name}")
        assert (level.prior_mean, level.prior_std) == (0.0, wide[name])
        assert level.local
        assert level.role is ParameterRole.NUISANCE
        assert [t.kind for t in model.transforms if t.input == name] == ["bias"]
    assert with_levels(LATERAL, {}) == LATERAL
    # compared in airspeed: its level is a bias, and no other one comes with it
    pitching = load_model("longitudinal", "cdfp")
    made = with_nuisance(with_levels(pitching, {"V": 0.4}), {"V": 0.1, "q": 0.01}, 0.02, AS_SET)
    assert made.parameter("bias_V").prior_std == 0.4
    assert made.parameter("bias_V").local
    assert made.parameter("bias_q").prior_std == 0.01


def test_what_was_found_from_the_motion_is_no_measurement() -> None:
    given = flown("a", {"beta": 0.02})
    assert not as_measured(given).measured("beta")
    assert as_measured(given).measured("ay")
    vane = flown("b")
    assert as_measured(vane) is vane


def test_an_attitude_with_times_of_its_own_may_be_late_by_a_share_of_its_own_interval() -> None:
    assert stamped_attitudes(LATERAL, [flown("a")]) == {}
    stamped = stamped_attitudes(LATERAL, [flown("a", hz=25.0), flown("b", hz=10.0)])
    assert stamped == {"phi": 0.1}
    for filtered in ((), ("phi",)):
        made = with_nuisance(LATERAL, {}, 0.02, AS_SET, filtered, stamped)
        assert made.parameter("timing_phi").prior_std == pytest.approx(AS_SET.timing_share * 0.1)
        assert ("plumb_phi" in made.parameter_names) is bool(filtered)
    assert with_nuisance(LATERAL, {}, 0.02, AS_SET, (), {"phi": 0.005}).parameter(
        "timing_phi"
    ).prior_std == pytest.approx(AS_SET.timing_share * 0.02)


def test_a_base_without_beliefs_and_without_a_vane_is_begun_where_maximum_likelihood_ends() -> None:
    """A business jet without vanes: no regression, and from derivatives of nothing the fit crept nowhere and was refused."""
    (flight, *_) = flights(truth.fly(requests({}, 61001, 0.15, "rich")))
    blind = replace(flight, columns={c: v for c, v in flight.columns.items() if c != "beta"})
    unknown, _ = compared(LATERAL.with_starts(dict.fromkeys(LATERAL.free_names, 0.0)), [blind])
    lost = GapError("runs away")
    begun = _with_estimated_starts(unknown, [blind], lost).starts()
    assert begun["Cl_p"] < -0.3
    assert begun["Cn_beta"] == pytest.approx(truth.TRUE_DERIVATIVES["Cn_beta"], rel=0.5)
    with pytest.raises(GapError) as refused:
        _with_estimated_starts(unknown, [blind.part(slice(0, 3))], lost)
    assert refused.value is lost


# What bends with sideslip or moves like a rest of it; all 45 are asked by the study of logs without vanes.
NEAR = ("Cl_beta3", "Cn_beta3", "CY_beta3", "Cl_da3", "Cn_da", "Cl_betadot", "rudder_delay", "attitude_lag", "gust")


@pytest.mark.parametrize(
    ("hidden", "named"), [pytest.param((), [], marks=pytest.mark.study), (("Cl_beta3",), ["Cl_beta3"])]
)
def test_sideslip_nobody_measured_is_not_missed(hidden: tuple[str, ...], named: list[str]) -> None:
    given = flights(truth.fly(requests(dict.fromkeys(hidden, 1.0), 51001, 0.15, "rich")))
    blind = [replace(f, columns={c: v for c, v in f.columns.items() if c != "beta"}) for f in given]
    near = [e for e in catalogue(model=LATERAL) if e.name in NEAR]
    result = run_gap(LATERAL, blind[:3], blind[3:], near, Options(seed=1, nulls=20))
    assert [s.effect for s in result.steps] == named
    assert result.text.endswith("Not measured, and so not compared: beta.")
    assert "beta" not in result.outputs


@pytest.mark.timeout(600)
@pytest.mark.parametrize(
    ("model", "seed", "hidden", "named"),
    [
        pytest.param("lateral", 954, (), [], marks=pytest.mark.study),
        pytest.param("lateral", 958, ("rudder_delay",), ["rudder_delay"], marks=pytest.mark.study),
        pytest.param("longitudinal", 955, (), [], marks=pytest.mark.study),
        pytest.param("longitudinal", 957, ("elevator_lag",), ["elevator_lag"], marks=pytest.mark.study),
    ],
)
def test_logs_without_vanes(
    tmp_path_factory: pytest.TempPathFactory, model: str, seed: int, hidden: tuple[str, ...], named: list[str]
) -> None:
    """ArduPilot logs with pitot, imported and reconstructed: each had been an unknown rest, with nothing hidden too."""
    given = reconstructed(tmp_path_factory.mktemp("logs"), model, hidden, seed)
    assert {"alpha", "beta"} <= set(given[0].reconstructed)
    result = run_gap(load_model(model, "cdfp"), given[:3], given[3:], options=Options(seed=1, nulls=40))
    assert [s.effect for s in result.steps] == named
    assert "look at the flights" not in result.text
