"""The Sport Cub benchmark on a record of the same form, flown by a rigid body of quaternions of its own."""

from pathlib import Path

import numpy as np
import pytest
from scipy.integrate import solve_ivp
from scipy.spatial.transform import Rotation

from tests.studies import sportcub as study

G, RHO, M, S, B, C = 9.80665, 1.225, 0.063, 0.05553, 0.617, 0.09
INERTIA = np.array([[6.9e-4, 0.0, -3.5e-5], [0.0, 6.0e-4, 0.0], [-3.5e-5, 0.0, 1.25e-3]])
SAMPLES = 120


def rates_of_change(t: float, x: np.ndarray, command: np.ndarray) -> np.ndarray:
    """Position, body velocity, quaternion and rates; z down."""
    attitude, velocity, (p, q, r) = Rotation.from_quat(x[6:10], scalar_first=True), x[3:6], x[10:]
    throttle, elevator, aileron, rudder = command[min(int(t / study.STEP + 1e-9), len(command) - 1)]
    speed = float(np.linalg.norm(velocity))
    alpha, beta = np.arctan2(velocity[2], velocity[0]), np.arcsin(velocity[1] / speed)
    roll, pitch, yaw = p * B / 2 / speed, q * C / 2 / speed, r * B / 2 / speed
    lift = 1.0 + 4.2 * alpha
    drag, side = 0.08 + 0.09 * lift**2, -0.6 * beta
    pressure = 0.5 * RHO * speed**2 * S
    force = np.array([lift * np.sin(alpha) - drag * np.cos(alpha), side, -lift * np.cos(alpha) - drag * np.sin(alpha)])
    acceleration = pressure / M * force + np.array([3.1 * throttle, 0, 0]) + attitude.inv().apply([0, 0, G])
    moment = pressure * np.array(
        [
            B * (-0.03 * beta - 0.15 * roll + 0.08 * yaw + 0.02 * aileron),
            C * (0.02 - 0.4 * alpha - 9.0 * pitch + 0.09 * elevator),
            B * (0.04 * beta - 0.15 * yaw + 0.02 * roll - 0.02 * aileron + 0.02 * rudder),
        ]
    )
    turning = np.linalg.solve(INERTIA, moment - np.cross(x[10:], INERTIA @ x[10:]))
    w, i, j, k = x[6:10]
    spin = 0.5 * np.array([-i * p - j * q - k * r, w * p + j * r - k * q, w * q - i * r + k * p, w * r + i * q - j * p])
    return np.concatenate([attitude.apply(velocity), acceleration - np.cross(x[10:], velocity), spin, turning])


def write_split(path: Path, seeds: range, mirror: np.ndarray) -> None:
    """A file of theirs; mirror: signs of the 12 states that the record turns."""
    states, commands = [], []
    for seed in seeds:
        rng = np.random.default_rng(seed)
        command = np.column_stack([np.full(SAMPLES, 0.45), *(np.zeros(SAMPLES) for _ in range(3))])
        command[20:60, 1 + seed % 3], command[60:90, 1 + seed % 3] = 0.6, -0.6
        command[40:, 0] += 0.2 * rng.standard_normal()
        start = np.r_[0, 0, -1.5, 4.4, 0.1, 0.0, 1, 0, 0, 0, 0.2 * rng.standard_normal(3)]
        times = study.STEP * np.arange(SAMPLES)
        pieces = [start]
        for t in times[:-1]:
            run = solve_ivp(rates_of_change, (t, t + study.STEP), pieces[-1], args=(command,), rtol=1e-6, atol=1e-8)
            pieces.append(run.y[:, -1])
        flown = np.array(pieces)
        angles = Rotation.from_quat(flown[:, 6:10], scalar_first=True).as_euler("ZYX")[:, ::-1]
        turned = np.hstack([flown[:, :6], angles, flown[:, 10:]]) * mirror
        quaternions = Rotation.from_euler("ZYX", turned[:, [8, 7, 6]]).as_quat(scalar_first=True)
        states.append(np.hstack([turned[:, :6], quaternions, turned[:, 9:]]))
        commands.append(command)
    table, names = np.array(states), np.array([f"segment_{s}" for s in seeds])
    np.savez(
        path, valid_mask=np.ones(table.shape[:2], bool), direct_state_meas=table, mocap_meas=table[..., study.POSE],
        u_cmd=np.array(commands), segment_names=names,
    )  # fmt: skip


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Five training and two validation segments in which z points up, as in the record."""
    path = tmp_path_factory.mktemp("sportcub")
    write_split(path / "train.npz", range(5), study.MIRROR)
    write_split(path / "validation.npz", range(6, 8), study.MIRROR)
    return path


def test_a_mirrored_record_is_noticed_and_predicted(folder: Path) -> None:
    train, validation = study.load_split(folder / "train.npz"), study.load_split(folder / "validation.npz")
    assert np.median(study.speed_gained_descending(train)) < -4.0
    model = study.fitted(study.candidates()["plain"], study.flights_of(train, True))
    found = model.starts()
    for name, value in {
        "CL_alpha": 4.2,
        "CD_k": 0.09,
        "CY_beta": -0.6,
        "Cl_p": -0.15,
        "Cm_q": -9.0,
        "Cn_beta": 0.04,
    }.items():
        assert found[name] == pytest.approx(value, rel=0.05)
    paths = [study.rollout(model, f, True) for f in study.flights_of(validation, True)]
    assert study.score(paths, validation.states) < 0.01
    as_published = study.fitted(study.candidates()["plain"], study.flights_of(train, False))
    upside_down = [study.rollout(as_published, f, False) for f in study.flights_of(validation, False)]
    assert not study.score(upside_down, validation.states) < 0.05


def test_an_upright_record_is_left_as_it_is(tmp_path: Path) -> None:
    write_split(tmp_path / "train.npz", range(3), np.ones(12))
    split = study.load_split(tmp_path / "train.npz")
    assert np.median(study.speed_gained_descending(split)) > 4.0
    assert study.to_theirs(study.to_model(split.states[0], True), True) == pytest.approx(split.states[0], abs=1e-9)


def test_states_of_poses_are_the_states(folder: Path) -> None:
    split = study.load_split(folder / "train.npz")
    made = study.by_poses(split).states[0]
    assert np.abs(made - split.states[0])[10:-10, 3:6].max() < 0.03
    assert np.abs(made - split.states[0])[10:-10, 10:].max() < 0.25


def test_the_score_is_error_over_range() -> None:
    rng = np.random.default_rng(4)
    truth = rng.uniform(-1.0, 1.0, (50, 13))
    truth[0], truth[1] = -1.0, 1.0  # a range of two in every column
    off = truth.copy()
    off[:, 0] += 0.5
    off[:, 6:10] *= -1.0  # the same attitude
    assert study.score([off], [truth]) == pytest.approx(0.25 / 13)
