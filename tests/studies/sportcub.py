"""The Sport Cub benchmark of github.com/jgoppert/sysid_litreview_26, scored as its authors do.

    python -m tests.studies.sportcub FOLDER [--choose] [--score]

FOLDER holds their `train.npz` and `validation.npz` (pose in a motion-capture hall, states made of it, stick commands, 100 Hz).
Without an option it says which way the vertical axis points and repeats two published rows. --choose compares models on training
segments alone, each predicted from a fit to the others; --score fits the chosen model to the training segments and predicts the
validation segments from their first sample. The page is docs/validation/sportcub.md.
"""

import argparse
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray
from scipy.signal import savgol_filter
from scipy.spatial.transform import Rotation

from estimation.engine.simulate import Simulator
from estimation.estimators.output_error import OutputErrorOptions, output_error
from estimation.models import read_model
from estimation.models.base import InputTransform, Model, Parameter
from estimation.prepare.pipeline import prepare
from groundstation.flight import Flight
from tests.support.paths import ROOT

Array = NDArray[np.float64]
Mask = NDArray[np.bool_]

MODEL = ROOT / "docs" / "validation" / "sportcub" / "sportcub.toml"
STEP = 0.01  # s between samples
STATES = ("north", "east", "down", "u", "v", "w", "phi", "theta", "psi", "p", "q", "r")
COMMANDS = ("throttle", "cmd_e", "cmd_a", "cmd_r")
MIRROR = np.array([1, 1, -1, 1, 1, -1, -1, -1, 1, -1, -1, 1.0])
"""Of position, velocity, Euler angles and rates, where z points up in world and body: a reflection in the horizontal plane."""
RIDGE = 1e-5  # theirs
SLOWEST, FASTEST, FASTEST_TURN = 2.5, 12.0, 80.0  # m/s and rad/s: limits of a predicted state, theirs
POSE = [0, 1, 2, 6, 7, 8, 9]  # of their 13 states
HELD_AS_MEASURED = OutputErrorOptions(hold="hold", improve_start=False)
OPTIONS = OutputErrorOptions(hold="hold")
CHOSEN = "thrust turns and rolls"


@dataclass(frozen=True)
class Split:
    """Segments of their record. states: (N, 13) position, velocity, quaternion, rates; poses: (N, 7); commands: (N, 4)."""

    names: tuple[str, ...]
    states: tuple[Array, ...]
    poses: tuple[Array, ...]
    commands: tuple[Array, ...]

    def cropped(self, samples: int) -> "Split":
        first = [tuple(x[:samples] for x in series) for series in (self.states, self.poses, self.commands)]
        return Split(self.names, *first)

    @property
    def shortest(self) -> int:
        return min(map(len, self.states))


def load_split(path: Path) -> Split:
    """Valid samples of each segment of a `sysid.timeseries.ragged.v1` file."""
    with np.load(path, allow_pickle=False) as data:
        lengths = data["valid_mask"].sum(axis=1)
        series = [
            tuple(np.asarray(segment[:n], float) for segment, n in zip(data[key], lengths, strict=True))
            for key in ("direct_state_meas", "mocap_meas", "u_cmd")
        ]
        return Split(tuple(map(str, data["segment_names"])), *series)


def score(predicted: Sequence[Array], measured: Sequence[Array], quaternion: slice = slice(6, 10)) -> float:
    """Mean over the columns of the rms error over the range of the measured, as they define it; quaternions of either sign."""
    truth, prediction = np.concatenate(measured), np.concatenate(predicted)
    opposite = np.sum(prediction[:, quaternion] * truth[:, quaternion], axis=1) < 0.0
    prediction[opposite, quaternion] *= -1.0
    extent = np.ptp(truth, axis=0)
    rms = np.sqrt(np.mean((prediction - truth) ** 2, axis=0))
    return float(np.mean(rms / np.where(extent > 1e-10, extent, 1.0)))


# ------------------------------------------------------------------------------------------- which way is down
def speed_gained_descending(split: Split) -> Array:
    """(segments,) [m/s2] slope of dV/dt over the sine of the angle at which z grows: near +9.8 where z points down, as an
    aircraft with steady thrust gains speed by descending; near -9.8 where it points up."""
    slopes = []
    for states in split.states:
        velocity = savgol_filter(states[:, :3], 21, 3, deriv=1, delta=STEP, axis=0)[12:-12]
        speed = np.linalg.norm(velocity, axis=1)
        gain = savgol_filter(speed, 21, 3, deriv=1, delta=STEP)
        slopes.append(np.polyfit(velocity[:, 2] / speed, gain, 1)[0])
    return np.array(slopes)


def to_model(states: Array, mirror: bool) -> Array:
    """(N, 12) states of the model, STATES, of their 13 columns."""
    angles = Rotation.from_quat(states[:, 6:10], scalar_first=True).as_euler("ZYX")[:, ::-1]
    angles[:, 2] = np.unwrap(angles[:, 2])
    return np.hstack([states[:, :6], angles, states[:, 10:]]) * (MIRROR if mirror else 1.0)


def to_theirs(states: Array, mirror: bool) -> Array:
    """(N, 13) their columns of the model's states."""
    turned = states * (MIRROR if mirror else 1.0)
    quaternions = Rotation.from_euler("ZYX", turned[:, [8, 7, 6]]).as_quat(scalar_first=True)
    return np.hstack([turned[:, :6], quaternions, turned[:, 9:]])


# --------------------------------------------------------------------------------------------- models and fits
def candidates() -> Mapping[str, Model]:
    """Models to choose from, each the plain build-up with something more."""
    full = read_model(MODEL)
    plain = full.fixed("CL_q", "CL_de", "CY_p", "CY_r", "CY_dr", "thrust_V", "Cm_T")
    surfaces = ("cmd_e", "cmd_a", "cmd_r")
    lags = [Parameter("T_servo", "s", start=0.05, lower=0.0, upper=0.5)]
    return {
        "plain": plain,
        "damping and elevator in lift": full.fixed("CY_p", "CY_r", "CY_dr", "thrust_V", "Cm_T"),
        "thrust falls with airspeed": full.fixed("CL_q", "CL_de", "CY_p", "CY_r", "CY_dr", "Cm_T"),
        "thrust pitches": full.fixed("CL_q", "CL_de", "CY_p", "CY_r", "CY_dr", "thrust_V"),
        "drag of sideslip": plain.plus(terms={"CD": "CD_beta2*beta^2"}, parameters=[Parameter("CD_beta2", "1")]),
        "lag of servos": plain.plus(
            transforms=[InputTransform("lag", s, ("T_servo",)) for s in surfaces], parameters=lags
        ),
        CHOSEN: plain.plus(
            terms={"Cn": "Cn_T*throttle", "Cl": "Cl_T*throttle"},
            parameters=[Parameter("Cn_T", "1"), Parameter("Cl_T", "1")],
        ),
    }


def flights_of(split: Split, mirror: bool) -> list[Flight]:
    """A flight for each segment."""
    return [
        Flight.build(
            name,
            STEP * np.arange(len(states)),
            {
                **dict(zip(STATES, to_model(states, mirror).T, strict=True)),
                **dict(zip(COMMANDS, commands.T, strict=True)),
            },
        )
        for name, states, commands in zip(split.names, split.states, split.commands, strict=True)
    ]


def fitted(model: Model, flights: Sequence[Flight], options: OutputErrorOptions = OPTIONS) -> Model:
    """The model with the derivatives of all flights together by output error, each from its first measured sample."""
    result = output_error(model, list(flights), options=options)
    return model.with_starts({name: e.estimate for name, e in result.parameters.items()})


def rollout(model: Model, flight: Flight, mirror: bool) -> Array:
    """(N, 13) their columns predicted from the first sample and the commands alone."""
    simulator = Simulator.build(model, (), hold="hold")
    start = np.array([flight[s.source][0] if s.source in flight.columns else 0.0 for s in model.states])
    run = simulator.run(prepare(model, flight).segments[0], model.starts(), start)
    return to_theirs(run.x[:, : len(STATES)], mirror)


def left_out_score(model: Model, split: Split, mirror: bool) -> float:
    """Score of training segments, each predicted from a fit to the others."""
    flights, samples = flights_of(split, mirror), split.shortest
    start = fitted(model, flights)
    predictions = []
    for flight in flights:
        others = fitted(start, [f for f in flights if f is not flight], HELD_AS_MEASURED)
        predictions.append(rollout(others, flight, mirror)[:samples])
    return score(predictions, [s[:samples] for s in split.states])


# ------------------------------------------------------------------------------------- their rows and their states
def published_row(train: Split, validation: Split, memory: int) -> float:
    """Score of their ridge regression of the next state on `memory` states, the command and 1. 1: LinearSS, 3: Hankel."""
    samples = train.shortest
    rows, targets = [], []
    for states, commands in zip(train.states, train.commands, strict=True):
        for k in range(memory - 1, samples - 1):
            rows.append(np.r_[states[k - memory + 1 : k + 1].ravel(), commands[k], 1.0])
            targets.append(states[k + 1])
    A, B = np.array(rows), np.array(targets)
    weights = np.linalg.solve(A.T @ A + RIDGE * np.eye(A.shape[1]), A.T @ B)
    predictions = []
    for states, commands in zip(validation.states, validation.commands, strict=True):
        path = np.repeat(states[:1], len(states), axis=0)
        for k in range(memory - 1, len(states) - 1):
            path[k + 1] = _limited(np.r_[path[k - memory + 1 : k + 1].ravel(), commands[k], 1.0] @ weights)
        predictions.append(path)
    return score(predictions, validation.states)


def _limited(state: Array) -> Array:
    state[6:10] /= np.linalg.norm(state[6:10])
    speed = np.linalg.norm(state[3:6])
    state[3:6] *= np.clip(speed, SLOWEST, FASTEST) / max(speed, 1e-9)
    state[10:] = np.clip(state[10:], -FASTEST_TURN, FASTEST_TURN)
    return state


def states_of_poses(poses: Array) -> Array:
    """(N, 13) states from position and quaternion alone: derivatives of a cubic through 0.21 s, one-sided at the ends."""
    window = min(21, len(poses) - (len(poses) + 1) % 2)
    position, velocity = (savgol_filter(poses[:, :3], window, 3, deriv=d, delta=STEP, axis=0) for d in (0, 1))
    attitude = Rotation.from_quat(poses[:, 3:], scalar_first=True)
    turned = savgol_filter((attitude[0].inv() * attitude).as_rotvec(), window, 3, axis=0)
    smooth = attitude[0] * Rotation.from_rotvec(turned)
    rates = (smooth[:-1].inv() * smooth[1:]).as_rotvec() / STEP
    rates = np.vstack([1.5 * rates[:1] - 0.5 * rates[1:2], 0.5 * (rates[1:] + rates[:-1]), rates[-1:]])
    quaternions = smooth.as_quat(scalar_first=True)
    return np.hstack([position, smooth.inv().apply(velocity), quaternions, rates])


def by_poses(split: Split) -> Split:
    """The split with states from motion capture instead of those given."""
    return Split(split.names, tuple(states_of_poses(p) for p in split.poses), split.poses, split.commands)


def main(folder: Path, choose: bool, submit: bool) -> None:
    train, validation = load_split(folder / "train.npz"), load_split(folder / "validation.npz")
    validation = validation.cropped(validation.shortest)
    slopes = speed_gained_descending(train)
    mirror = bool(np.median(slopes) < 0.0)
    print(
        f"dV/dt over the sine of descent by z: {', '.join(f'{s:.1f}' for s in slopes)} m/s2: "
        f"z points {'up' if mirror else 'down'}"
    )
    for name, memory, published in (("6DOF-LinearSS", 1, 0.4661), ("6DOF-Subspace-Hankel", 3, 0.2131)):
        print(f"{name}: {published_row(train, validation, memory):.4f}, published {published}")
    if choose:
        for name, model in candidates().items():
            print(f"{name}: left out {left_out_score(model, train, mirror):.4f}", flush=True)
    if submit:
        for source, known, begun in (
            ("direct", train, validation),
            ("mocap", by_poses(train), by_poses(validation.cropped(21))),
        ):
            model = fitted(candidates()[CHOSEN], flights_of(known, mirror))
            start = [np.vstack([b[:1], v[1:]]) for b, v in zip(begun.states, validation.states, strict=True)]
            flights = flights_of(Split(validation.names, tuple(start), validation.poses, validation.commands), mirror)
            paths = [rollout(model, flight, mirror) for flight in flights]
            pose = score([p[:, POSE] for p in paths], validation.poses, slice(3, 7))
            print(f"{source}: states {score(paths, validation.states):.4f}, pose {pose:.4f}")


if __name__ == "__main__":
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("folder", type=Path)
    parser.add_argument("--choose", action="store_true")
    parser.add_argument("--score", action="store_true")
    given = parser.parse_args()
    main(given.folder, given.choose, given.score)
