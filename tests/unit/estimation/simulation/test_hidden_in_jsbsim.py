"""JSBSim flies an aircraft with something hidden in it; the unchanged one is given as simulation."""

import json
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
import pytest
from click.testing import CliRunner

pytest.importorskip("jsbsim", reason="the package jsbsim is not installed")

from estimation.gap.answer.result import GapVerdict
from estimation.gap.effects import catalogue
from estimation.gap.workflow import Options
from estimation.models import load_model
from estimation.simulation.along_flight import AS_MOTION, motion
from estimation.simulation.attach import attach, simulation_of
from estimation.simulation.conversion import export_to_jsbsim
from estimation.simulation.jsbsim import flying
from groundstation.flight import Flight, write_flight
from sideslip.cli import cli
from tests.studies import jsbsim_flights as truth
from tests.unit.estimation.gap.whole_run import analyse

OFFERED = ("CY_da", "Cn_da", "Cl_beta3", "Cn_beta3", "Ixz_error", "aileron_lag", "rudder_lag", "beta_scale")
YAW = """<function name="aero/hidden/Cnda"><product><property>aero/qbar-psf</property><property>metrics/Sw-sqft</property>
<property>metrics/bw-ft</property><property>fcs/left-aileron-pos-rad</property><value>0.012</value></product></function>"""


def with_adverse_yaw(text: str) -> str:
    """Cn_da -0.012 beside the aileron yaw that the aircraft has."""
    assert text.count('<function name="aero/coefficient/Cndr">') == 1
    return text.replace('<function name="aero/coefficient/Cndr">', YAW + '<function name="aero/coefficient/Cndr">')


def test_the_rate_of_alpha_is_taken_from_the_accelerometers() -> None:
    """Within a quarter of its scatter of what the aircraft had, with noise; the slope of the vane alone is off by half of it."""
    asked = truth.Flown(truth.OWN / "c172p" / "c172p.xml", 1)
    clean, noisy = truth.columns_of(asked), truth.flight(asked, "f")
    simulation = simulation_of("jsbsim:c172p")
    model = load_model("longitudinal", simulation.aircraft)
    true = np.gradient(clean["alpha"], clean["time"])
    states, usable, _ = motion(model, noisy, {}, AS_MOTION)
    assert usable.all()
    assert np.std(states.alpha_dot - true) < 0.25 * np.std(true)
    without = replace(noisy, columns={n: v for n, v in noisy.columns.items() if n != "az"})
    vane, _, _ = motion(model.without_outputs("az"), without, {}, AS_MOTION)
    assert np.std(vane.alpha_dot - true) > 0.4 * np.std(true)


@dataclass(frozen=True)
class Hidden:
    """The aircraft as it flies, and flights of it: two to search, one held out."""

    file: Path
    flights: tuple[Flight, ...]


@pytest.fixture(scope="module")
def hidden(tmp_path_factory: pytest.TempPathFactory) -> Hidden:
    file = truth.changed(tmp_path_factory.mktemp("hidden"), "c172p", with_adverse_yaw)
    asked = [truth.Flown(file, 20 + i, speed, 22.0) for i, speed in enumerate((45.0, 53.0, 49.0))]
    return Hidden(file, tuple(truth.flight(a, f"f{i}") for i, a in enumerate(asked)))


def off_in_flight(hidden: Hidden, exported: Path, folder: Path) -> float:
    """What the flight of the exported aircraft would have for a gap, in floors."""
    asked = truth.Flown(hidden.file, 22, 49.0, 22.0)
    true = truth.columns_of(asked)
    own = truth.with_own_channel_only(exported, folder)
    again = truth.columns_of(replace(asked, file=own, trimmed=hidden.file))
    off = [(again[n] - true[n]) / truth.NOISE[n] for n in ("beta", "p", "r", "phi", "ay")]
    return float(np.sqrt(1.0 + np.mean(np.square(off))))


def test_a_hidden_yawing_moment_is_named_closed_exported_and_flies_in_the_export(
    hidden: Hidden, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Among some effects of the same axes; among all of them, and by the verbs, in the study below."""
    monkeypatch.setattr(flying, "DURATION", 12.0)  # s: aileron and rudder
    base = attach("jsbsim:c172p", "lateral", hidden.flights[1:])
    effects = [e for e in catalogue(model=base.model) if e.name in OFFERED]
    assert len(effects) == len(OFFERED)
    options, file = Options(nulls=30), tmp_path / "gap.json"
    answer = analyse(
        base.model, base.training(1), base.holdout(1), effects, options, lambda *_: None, tmp_path / "gap-models", file
    )
    assert answer.verdict is GapVerdict.GAP_CLOSED
    (step,) = answer.steps
    assert step.effect == "Cn_da"
    assert step.estimates["Cn_da"][0] == pytest.approx(-0.012, rel=0.05)
    assert step.holdout is not None
    assert step.holdout.closed > 0.9
    done = export_to_jsbsim(Path(answer.files[1]), None, tmp_path / "out")
    assert "aero/sideslip/Cn_da" in done.exported.file.read_text(encoding="utf-8")
    assert off_in_flight(hidden, done.exported.file, tmp_path / "flown") < 1.1  # within a tenth of the floor


@pytest.mark.study
@pytest.mark.timeout(900)
def test_the_same_by_the_verbs_among_all_effects(hidden: Hidden, tmp_path: Path) -> None:
    paths = [str(tmp_path / f"{f.name}.csv") for f in hidden.flights]
    for flight, path in zip(hidden.flights, paths, strict=True):
        write_flight(flight, path)
    out = tmp_path / "gap.json"
    words = [
        "gap",
        *paths[:2],
        "--holdout",
        paths[2],
        "--simulation",
        "jsbsim:c172p",
        "--nulls",
        "30",
        "--json",
        str(out),
    ]
    done = CliRunner().invoke(cli, words, catch_exceptions=False)
    assert done.exit_code == 0, done.output
    answer = json.loads(out.read_text(encoding="utf-8"))
    assert answer["verdict"] == "gap_closed"
    (step,) = answer["steps"]
    assert step["effect"] == "Cn_da"
    assert step["parameters"]["Cn_da"]["estimate"] == pytest.approx(-0.012, rel=0.05)
    assert step["holdout"]["closed"] > 0.9
    assert "flap" in done.output  # what is held is told
    assert "Cn_da" in Path(answer["model_after"]).name
    written = CliRunner().invoke(
        cli, ["export", answer["model_after"], "--to", "jsbsim", "--out", str(tmp_path / "out")], catch_exceptions=False
    )
    assert written.exit_code == 0, written.output
    exported = next((tmp_path / "out").glob("*/*-sideslip.xml"))
    assert "aero/sideslip/Cn_da" in exported.read_text(encoding="utf-8")
    assert off_in_flight(hidden, exported, tmp_path / "flown") < 1.1
