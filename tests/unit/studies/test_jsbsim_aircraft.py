"""The study of JSBSim's aircraft: slopes are those of the file, manoeuvres as large as asked for, one aircraft is identified."""

from pathlib import Path

import numpy as np
import pytest

pytest.importorskip("jsbsim", reason="JSBSim is not installed: pip install '.[jsbsim]'")

from tests.studies import jsbsim_aircraft as study  # needs jsbsim
from tests.support.gallery.aircraft import executive, glide, properties


def trimmed(name: str, folder: Path) -> tuple[object, dict[str, float], dict[str, float]]:
    fdm = executive(name, folder)
    fdm.run_ic()
    shape = properties(fdm)
    x = glide(fdm, 110.0)
    trim = dict(zip(("alpha", "theta", "phi", *study.SURFACES), x.tolist(), strict=True))
    return fdm, shape, {**trim, "V": 110.0, "beta": 0.0, "p": 0.0, "q": 0.0, "r": 0.0}


def test_slopes_are_those_of_the_file(tmp_path: Path) -> None:
    """F-80C: constant derivatives in its file (aero moments about the CG, forces in wind axes)."""
    fdm, shape, trim = trimmed("F80C", tmp_path)
    lateral = study.slopes(fdm, study.LATERAL, trim, shape)
    pitching = study.slopes(fdm, study.PITCHING, trim, shape)
    assert pitching["CL_de"] == pytest.approx(0.2, rel=0.03)
    assert lateral["Cl_p"] < -0.1
    assert lateral["Cn_beta"] > 0.02
    # a wind-axes side force and the drag that turns into body axes with sideslip
    moved = [study.coefficients(fdm, shape)]
    study.put(fdm, {**trim, "beta": 0.05})
    moved.append(study.coefficients(fdm, shape))
    study.put(fdm, trim)
    moved[0] = study.coefficients(fdm, shape)
    assert (moved[1]["CY"] - moved[0]["CY"]) / 0.05 == pytest.approx(lateral["CY_beta"], rel=0.03)


def test_linear_motion_has_the_modes_of_the_nonlinear(tmp_path: Path) -> None:
    """A free decay of JSBSim from a small sideslip: its yaw rate swings as the eigenvalue says."""
    fdm, _, trim = trimmed("F80C", tmp_path)
    a, _ = study.linearised(fdm, study.LATERAL, trim)
    dutch = max(np.linalg.eigvals(a), key=lambda v: abs(v.imag))
    study.set_state(
        fdm, 110.0, trim["alpha"], 0.02, trim["theta"], trim["phi"], np.zeros(3), [trim[n] for n in study.SURFACES]
    )
    yaw = []
    for _ in range(study.RATE * 8):
        fdm.run()
        yaw.append(fdm["velocities/r-rad_sec"])
    falls = np.flatnonzero(np.diff(np.sign(yaw)) < 0) / study.RATE
    assert np.diff(falls)[0] == pytest.approx(2 * np.pi / abs(dutch.imag), rel=0.05)


@pytest.mark.parametrize("plane", study.PLANES, ids=lambda p: p.model)
def test_manoeuvres_are_as_large_as_they_may(plane: study.Plane, tmp_path: Path) -> None:
    fdm, _, trim = trimmed("F80C", tmp_path)
    plan = study.manoeuvre(plane, *study.linearised(fdm, plane, trim), np.random.default_rng(5))
    moved = [study.SURFACES.index(n) for n in plane.surfaces]
    assert all(0.005 < np.abs(plan.added[k]).max() <= study.TRAVEL for k in moved)
    assert all(not plan.added[k].any() for k in range(3) if k not in moved)
    assert 24.0 <= plan.duration <= 64.0


def test_an_aircraft_is_identified_blind(tmp_path: Path) -> None:
    found = study.identified("A4", study.LATERAL, tmp_path, 6)
    assert found.linear
    assert found.recommended == "ml"
    assert len(found.errors) >= 11
    assert sum(abs(e) <= study.INSIDE for e in found.errors.values()) >= len(found.errors) - 1


def test_a_slope_of_a_curve_is_a_range() -> None:
    flown = study.Flown({}, None, {"Cm_alpha": np.array([-0.5, -0.6])}, {"Cm_alpha": -0.62}, 0.0)  # type: ignore[arg-type]
    assert flown.error("Cm_alpha", -0.55) == 0.0
    assert flown.error("Cm_alpha", -0.64) == pytest.approx(-0.02)
    assert flown.error("Cm_alpha", -0.45) == pytest.approx(0.05)
    assert flown.error_of_mean("Cm_alpha", -0.56) == pytest.approx(-0.01)
