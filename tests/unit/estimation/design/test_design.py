"""Designs: predictions against estimates of flights, bounds against each other, limits, files."""

import json
import math
from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from daq.contract.manoeuvre import ManoeuvreError, load_manoeuvre
from estimation.aircraft import load_aircraft
from estimation.answers.designs import _against_doublets, _from_estimate, with_effects, write_manoeuvre
from estimation.design import measured_inputs
from estimation.design.design import DesignTask, InputDesign, design
from estimation.design.limits import Limits, load_limits, trimmed, usual_limits
from estimation.design.predict import DesignInformation, fly, information
from estimation.errors import EstimationError
from estimation.estimators.output_error import output_error
from estimation.models import load_model
from estimation.prepare.flight_data import FlightData, Segment

AIRCRAFT = load_aircraft("cdfp")
LATERAL = load_model("lateral", AIRCRAFT)
TASK = DesignTask("multisine", 20.0, 16.0, draws=7)


@pytest.fixture(scope="module", autouse=True)
def few() -> Iterator[None]:
    """Fewer flights with noisy inputs than a prediction takes: what is compared here has the same noise in both."""
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(measured_inputs, "LEAST_DRAWS", TASK.draws)
        yield


@pytest.fixture(scope="module")
def sines() -> InputDesign:
    return design(LATERAL, AIRCRAFT, TASK)


def mean_relative(found: InputDesign) -> float:
    return float(np.mean(list(found.relative.values())))


class TestPrediction:
    def test_trimmed_flight_stays_trimmed(self) -> None:
        model = load_model("longitudinal", AIRCRAFT)
        found = design(model, AIRCRAFT, DesignTask("doublet", 10.0, 16.0))
        rest = fly(found.setting, np.zeros((250, 1)))
        for name in model.state_names:
            assert np.ptp(rest.signals[name]) < 1e-6, name
        assert trimmed(model, AIRCRAFT, 16.0, 1.17).trim_value("alpha") == pytest.approx(
            rest.signals["alpha"][-1], abs=1e-6
        )

    def test_predicted_bounds_are_those_of_a_fit_to_such_a_flight(self, sines: InputDesign) -> None:
        """The estimator's own Cramer-Rao bounds on a simulated record with the predicted noise."""
        setting, motion = sines.setting, sines.best.motion
        keep = np.arange(0, len(motion.time), round(0.05 / (motion.time[1] - motion.time[0])))
        names = LATERAL.output_names
        rng = np.random.default_rng(4)
        sigma = np.array([math.radians(0.25), math.radians(0.4), math.radians(0.3), math.radians(0.3), 0.05])
        z = np.column_stack([motion.signals[n][keep] for n in names]) + sigma * rng.standard_normal((keep.size, 5))
        u = np.column_stack(
            [
                motion.surfaces.get(s.name, np.full(len(motion.time), setting.condition.trim_value(s.name)))[keep]
                for s in LATERAL.inputs
            ]
        )
        segment = Segment(0, motion.time[keep], u, z, np.zeros(4))
        states = np.column_stack([motion.signals[n][keep] for n in LATERAL.state_names])
        data = FlightData("made", keep.size, (segment,), states, {}, (), ())
        result = output_error(LATERAL, data)
        for name, std in sines.best.information.std.items():
            assert result.parameters[name].std == pytest.approx(std, rel=0.15), name

    def test_information_adds_and_scales(self, sines: InputDesign) -> None:
        small = information(sines.setting, fly(sines.setting, 0.05 * sines.best.commands))
        smaller = information(sines.setting, fly(sines.setting, 0.025 * sines.best.commands))
        assert small.std["Cl_p"] == pytest.approx(0.5 * smaller.std["Cl_p"], rel=0.02)

    def test_bounds_by_inverse_and_what_is_tied_is_infinite(self) -> None:
        rng = np.random.default_rng(2)
        a = rng.normal(size=(30, 3)) * [1.0, 1e-4, 1e3]
        free = DesignInformation(("x", "y", "z"), a.T @ a).std
        np.testing.assert_allclose(list(free.values()), np.sqrt(np.diag(np.linalg.inv(a.T @ a))), rtol=1e-6)
        tied = np.column_stack([a, 2.0 * a[:, 0]])
        std = DesignInformation(("x", "y", "z", "x2"), tied.T @ tied).std
        assert math.isinf(std["x"])
        assert math.isinf(std["x2"])
        assert std["y"] == pytest.approx(free["y"], rel=1e-4)
        assert math.isinf(DesignInformation(("still",), np.zeros((1, 1))).std["still"])


class TestKinds:
    def test_multisines_beat_doublets_and_use_the_amplitudes(self, sines: InputDesign) -> None:
        better = replace(sines, task=replace(sines.task, draws=21))
        plain = design(LATERAL, AIRCRAFT, replace(TASK, kind="doublet", draws=21))
        assert mean_relative(better) < 0.70 * mean_relative(plain)
        assert better.gain > 1.4
        assert plain.gain == pytest.approx(1.0)
        assert all(u.share <= 1.0 + 1e-9 for u in sines.best.used)
        assert all(factor < 1.1 for factor in sines.peak_factors().values())

    @pytest.mark.parametrize("kind", ["121", "3211", "chirp"])
    def test_other_shapes_keep_inside_the_limits(self, kind: str) -> None:
        found = design(LATERAL, AIRCRAFT, replace(TASK, kind=kind))
        assert all(u.share <= 1.0 + 1e-9 for u in found.best.used)
        assert found.best.commands.shape[1] == 2
        assert abs(found.best.commands[-1]).max() < 1e-9

    def test_limits_on_the_response_bind(self) -> None:
        tight = Limits(response={"beta": (-math.radians(3.0), math.radians(3.0), True)})
        found = design(LATERAL, AIRCRAFT, TASK, tight)
        beta = np.abs(found.best.motion.signals["beta"]).max()
        assert math.radians(2.7) < beta <= math.radians(3.0) * (1 + 1e-6)

    @pytest.mark.parametrize(("criterion", "name"), [("CY_beta", "CY_beta"), ("A", ""), ("D", "")])
    def test_optimal_is_never_worse_than_flat_by_its_own_criterion(
        self, criterion: str, name: str, sines: InputDesign
    ) -> None:
        found = design(LATERAL, AIRCRAFT, replace(TASK, kind="optimal", criterion=criterion))
        before, after = sines.best.information, found.best.information
        if name:
            assert after.std[name] <= before.std[name] * (1 + 1e-9)
        elif criterion == "D":
            assert np.linalg.slogdet(after.matrix)[1] >= np.linalg.slogdet(before.matrix)[1] - 1e-9
        else:
            assert sum(r**2 for r in found.relative.values()) <= sum(r**2 for r in sines.relative.values())

    def test_longitudinal_and_other_controls(self) -> None:
        found = design(load_model("longitudinal", AIRCRAFT), AIRCRAFT, replace(TASK, kind="3211"))
        assert found.setting.controls == ("delta_e",)
        assert max(found.relative.values()) < 0.1
        only = design(LATERAL, AIRCRAFT, replace(TASK, controls=("delta_a",)))
        assert "Cn_dr" in only.untold
        assert "Cl_da" not in only.untold

    def test_a_gap_is_separated_by_the_axis_that_can(self) -> None:
        lateral, sizes = with_effects(LATERAL, ("Cn_da", "Ixz_error"))
        with pytest.raises(EstimationError, match="six-dof"):
            design(lateral, AIRCRAFT, replace(TASK, kind="optimal", separate=tuple(sizes), sizes=sizes))
        whole, sizes = with_effects(load_model("six-dof", AIRCRAFT), ("Cn_da", "Ixz_error"))
        found = design(whole, AIRCRAFT, replace(TASK, kind="multisine", separate=tuple(sizes), sizes=sizes))
        assert max(found.relative.values()) < 0.3


class TestWords:
    @pytest.mark.parametrize(
        ("change", "words"),
        [
            ({"kind": "wobble"}, "choose from doublet"),
            ({"duration": 0.5}, "2 to 600"),
            ({"controls": ("delta_x",)}, "delta_a, delta_r"),
            ({"criterion": "Cl_q"}, "Cl_q"),
            ({"duration": 2.0, "band": (0.6, 0.9)}, "wider --band"),
        ],
    )
    def test_what_cannot_be_designed_is_said(self, change: dict[str, object], words: str) -> None:
        with pytest.raises(EstimationError, match=words):
            design(LATERAL, AIRCRAFT, replace(TASK, **change))  # type: ignore[arg-type]

    @pytest.mark.parametrize(
        ("text", "words"),
        [
            ("nonsense", "not a TOML"),
            ("[controls.delta_a]\namplitude_deg = -1", "amplitude_deg"),
            ("[controls.delta_a]\namplitude = 1", "amplitude"),
            ("[response]\nbeta_deg = [5, 1]", "beta_deg"),
            ("[response]\nbeta_deg = nan", "beta_deg"),
        ],
    )
    def test_limits_files(self, tmp_path: Path, text: str, words: str) -> None:
        (tmp_path / "limits.toml").write_text(text)
        with pytest.raises(EstimationError, match=words):
            load_limits(tmp_path / "limits.toml")

    def test_limits_in_degrees_become_radians(self, tmp_path: Path) -> None:
        text = "[controls.delta_a]\namplitude_deg = 4\n[response]\nbeta_deg = 6\nload_factor = [0.5, 2.0]\np_deg_s = 90"
        (tmp_path / "limits.toml").write_text(text)
        limits = load_limits(tmp_path / "limits.toml")
        assert limits.amplitude_of("delta_a") == pytest.approx(math.radians(4.0))
        assert limits.amplitude_of("delta_r") == usual_limits().amplitude_of("delta_r")
        assert limits.response["beta"][1] == pytest.approx(math.radians(6.0))
        assert limits.response["p"][1] == pytest.approx(math.radians(90.0))
        assert limits.response["load_factor"] == (0.5, 2.0, False)


class TestFile:
    def test_read_back_as_written(self, sines: InputDesign, tmp_path: Path) -> None:
        write_manoeuvre(sines, tmp_path / "m.toml")
        again = load_manoeuvre(tmp_path / "m.toml")
        assert again.digest == sines.manoeuvre().digest
        assert (again.aircraft, again.model, again.kind) == ("cdfp", "lateral", "multisine")
        assert again.duration_s == pytest.approx(20.0)
        np.testing.assert_allclose(again.increments["delta_a"], sines.best.commands[:, 0], atol=1e-6)

    def test_a_changed_value_is_refused(self, sines: InputDesign, tmp_path: Path) -> None:
        write_manoeuvre(sines, tmp_path / "m.toml")
        text = (tmp_path / "m.toml").read_text()
        value = repr(sines.manoeuvre().increments["delta_a"][200])
        assert value in text
        (tmp_path / "m.toml").write_text(text.replace(value, "0.09", 1))
        with pytest.raises(ManoeuvreError, match="digest"):
            load_manoeuvre(tmp_path / "m.toml")

    @pytest.mark.parametrize(
        ("old", "new", "words"),
        [
            ("version = 1", "version = 2", "version 1"),
            ("time_step = 0.02", "time_step = 5.0", "0.005 to 0.1"),
            ("time_step = 0.02", "time_step = 'x'", "design it again"),
            ("delta_a = [", "delta_a = [\n0.6,", "number of samples"),
            ("delta_a = [", "wing = [", "not a control"),
            ("[increments]", "[other]", "design it again"),
        ],
    )
    def test_damaged_files(self, sines: InputDesign, tmp_path: Path, old: str, new: str, words: str) -> None:
        write_manoeuvre(sines, tmp_path / "m.toml")
        text = (tmp_path / "m.toml").read_text()
        assert old in text
        (tmp_path / "m.toml").write_text(text.replace(old, new, 1))
        with pytest.raises(ManoeuvreError, match=words):
            load_manoeuvre(tmp_path / "m.toml")

    def test_json_is_as_the_interface_has_it(self, sines: InputDesign) -> None:
        content = json.loads(json.dumps(sines.to_json(), allow_nan=False))
        assert content["kind"] == "multisine"
        assert len(content["time"]) == len(content["inputs"]["delta_a"]) == 1001
        assert content["predicted"]["Cl_p"]["std"] > 0
        assert set(content["peak_factor"]) == {"delta_a", "delta_r"}
        assert content["limits"]["beta"]["used"] < content["limits"]["beta"]["allowed"]


def test_an_estimate_brings_the_aircraft_it_was_made_with(tmp_path: Path) -> None:
    one = {"estimate": -0.4, "identifiable": True}
    methods = {"ml": {"parameters": {"Cl_p": one}, "R": {"p": 1e-4}}}
    file = "[geometry]\nspan = 2.1\narea = 0.6\nchord = 0.3\n[mass]\nmass = 4.0\n"
    content = {
        "model": "lateral",
        "aircraft": "lark",
        "aircraft_file": file,
        "joint": {},
        "flights": [{"methods": methods}],
    }
    (tmp_path / "e.json").write_text(json.dumps(content))
    craft = _from_estimate(tmp_path / "e.json")["aircraft"]
    assert (craft.name, craft.span, craft.mass) == ("lark", 2.1, 4.0)


def test_an_input_worse_than_doublets_is_called_worse() -> None:
    assert _against_doublets(2.0) == "2.00 times smaller"
    assert _against_doublets(0.8) == "1.25 times larger"
