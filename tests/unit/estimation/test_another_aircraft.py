"""The whole way for an aircraft that Sideslip has never heard of: import, estimate, match; against scipy alone."""

import json
import re
import tomllib
from pathlib import Path

import numpy as np
import pytest
from click.testing import CliRunner
from scipy.optimize import least_squares
from scipy.signal import lsim

from estimation.models import load_model
from estimation.models.base import Model
from groundstation.cli.import_log import import_
from groundstation.flight import read_flight
from sideslip.verbs.estimate import estimate
from sideslip.verbs.match import match
from tests.support.paths import ROOT

DOCS = ROOT / "docs"
TRUE = np.array([-1.1, 0.97, -0.12, -6.2, -1.7, -9.5])
NAMES = ("Z_alpha", "Z_q", "Z_de", "M_alpha", "M_q", "M_de")
RATE = 10.0

MAP = """
format = 1
aircraft = "glider"
[time]
column = "Zeit"
unit = "ms"
[columns]
alpha = { column = "Anstell", unit = "deg" }
q = { column = "Nick", unit = "deg/s" }
delta_e = { column = "HR", unit = "deg", sign = -1 }
"""
MODEL = """
equations = [
  "alpha_dot = Z_alpha*alpha + Z_q*q + Z_de*delta_e",
  "q_dot = M_alpha*alpha + M_q*q + M_de*delta_e",
]
states = ["alpha", "q"]
inputs = [{ name = "delta_e", unit = "rad", control = true }]
outputs = [{ name = "alpha", unit = "rad" }, { name = "q", unit = "rad/s" }]
parameters = ["Z_alpha", "Z_q", "Z_de", "M_alpha", "M_q", "M_de"]
"""


def motion(theta: np.ndarray, time: np.ndarray, elevator: np.ndarray) -> np.ndarray:
    """(N, 2) alpha and q, exact for an elevator straight between samples; theta: six derivatives, two initial states."""
    A, B = theta[[0, 1, 3, 4]].reshape(2, 2), theta[[2, 5]].reshape(2, 1)
    return np.asarray(lsim((A, B, np.eye(2), np.zeros((2, 1))), elevator, time, X0=theta[6:8])[1])


@pytest.fixture(scope="module")
def record(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Ten samples a second of a short-period manoeuvre, in degrees and milliseconds under foreign names."""
    folder, rng = tmp_path_factory.mktemp("foreign"), np.random.default_rng(3)
    time = np.arange(301) / RATE
    corners = np.radians(3.0) * rng.choice([-1.0, 0.0, 1.0], 31)
    elevator = np.interp(time, np.arange(31.0), corners)
    y = motion(np.concatenate([TRUE, [0.01, 0.0]]), time, elevator) + [0.002, 0.003] * rng.normal(size=(301, 2))
    columns = [1000 * time, np.degrees(-elevator), *np.degrees(y.T)]
    np.savetxt(
        folder / "flug.csv", np.column_stack(columns), "%.6f", delimiter=";", header="Zeit;HR;Anstell;Nick", comments=""
    )
    (folder / "map.toml").write_text(MAP)
    (folder / "own.toml").write_text(MODEL)
    return folder


def run(command: object, *arguments: object) -> object:
    return CliRunner().invoke(command, [str(a) for a in arguments], standalone_mode=False, catch_exceptions=False)  # type: ignore[arg-type]


@pytest.mark.usefixtures("unwritten_figures")
def test_from_a_foreign_file_to_a_proof_of_match(record: Path) -> None:
    flight, results, fitted = record / "flug.mcap", record / "results.json", record / "fitted.toml"
    run(import_, record / "flug.csv", "-o", flight, "--map", record / "map.toml")
    done = run(
        estimate, flight, "--model", record / "own.toml", "--raw-inputs", "--json", results, "--save-model", fitted,
        "--report", record / "report",
    )  # fmt: skip
    assert done.return_value == 0  # type: ignore[attr-defined]
    data = json.loads(results.read_text())
    assert data["aircraft"] == "glider"
    found = data["flights"][0]["methods"]["ml"]
    std = np.array([found["parameters"][n]["std"] for n in NAMES])
    values = np.array([found["parameters"][n]["estimate"] for n in NAMES])
    assert np.abs((values - TRUE) / std).max() < 4.0

    used = read_flight(flight)
    noise = np.sqrt([found["R"]["alpha"], found["R"]["q"]])
    z = np.column_stack([used["alpha"], used["q"]])
    start = np.concatenate([TRUE * 1.1, z[0]])
    alone = least_squares(
        lambda theta: ((z - motion(theta, used.time, used["delta_e"])) / noise).ravel(), start, x_scale=np.abs(start)
    )
    assert np.abs((values - alone.x[:6]) / std).max() < 0.01

    judged = run(match, fitted, flight, "--histories", record / "shown")
    assert judged.return_value == 0  # type: ignore[attr-defined]
    assert np.isfinite(read_flight(record / "shown" / "flug.mcap")["q_model"]).all()
    page = (record / "report" / "index.html").read_text()
    assert "glider" in page
    assert "[]" not in page
    assert "of the paper" not in page


def test_model_files_of_the_documentation_are_models() -> None:
    text = (DOCS / "estimation.md").read_text(encoding="utf-8")
    blocks = re.findall(r"```toml\n(.*?)```", text, re.DOTALL)
    assert blocks
    for block in blocks:
        Model.from_dict({"name": "documented", **tomllib.loads(block)})
    everything = load_model(DOCS / "examples" / "short_period.toml")
    assert everything.free_names == (
        "Z_0", "M_0", "Z_alpha", "Z_de", "M_alpha", "M_q", "M_de", "bias_q", "T_e",
    )  # fmt: skip
    roles = {p.name: p.role.value for p in everything.parameters}
    assert (roles["Z_0"], roles["M_q"], roles["bias_q"]) == ("constant", "derivative", "instrument")
