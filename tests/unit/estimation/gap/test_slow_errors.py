"""What is slowly wrong with a control: nulls of slow motions are as white as the whitener says, and only with it."""

from dataclasses import replace

import numpy as np
import pytest

from estimation.engine.kernel import Array
from estimation.engine.simulate import Segment, Simulator
from estimation.gap.criteria import AS_SET
from estimation.gap.fit.linear_motion import linear_motion
from estimation.gap.fit.noise import NoiseModel, NoisePart, NoiseSource, shapes_of, whitener
from estimation.gap.fit.surface_steps import SLOW, SurfaceSteps, loosened, slow_errors, without_slow
from estimation.gap.fit.whitener import Whitener
from estimation.models.base import Model, Parameter, Signal

COUNT, STEP = 600, 0.05
TIME = STEP * np.arange(COUNT)
SLOWLY = Model(  # a swing of 8 to 12 s, faster where the flow is
    name="slowly",
    states=(Signal("theta", "rad"), Signal("q", "rad/s")),
    inputs=(Signal("delta_e", "rad", control=True), Signal("flow", "1")),
    outputs=(Signal("theta", "rad"), Signal("q", "rad/s")),
    parameters=(Parameter("stiff", start=0.4), Parameter("damp", start=0.1), Parameter("turn", start=2.0)),
    equations=("theta_dot = q", "q_dot = flow*(turn*delta_e - stiff*theta) - damp*q"),
)
VALUES = {"stiff": 0.4, "damp": 0.1, "turn": 2.0}
WRONG, NOISE = 1e-3, np.array([2e-4, 2e-4])  # rad of a control, white; rad and rad/s of the instruments
FLOW = np.linspace(0.7, 1.4, COUNT)
SEGMENT = Segment(0, TIME, np.column_stack([np.zeros(COUNT), FLOW]), np.zeros((COUNT, 2)), np.zeros(2))
LEFT = {"delta_e": np.full(COUNT // 2 + 1, WRONG**2)}
FREE = SurfaceSteps((), np.zeros(0), np.zeros(0), np.zeros((COUNT, 2, 0)), AS_SET)
SIMULATOR = Simulator.build(SLOWLY, (), substeps=1, hold="linear")


SHAPES = shapes_of(SLOWLY, linear_motion(SLOWLY, SIMULATOR, SEGMENT, VALUES), COUNT, AS_SET, (), LEFT)
KNOWN = NoiseModel(NOISE**2, {NoisePart(NoiseSource.PREPARED, "delta_e"): 1.0})


def by_spectrum_alone() -> Whitener:
    return whitener(KNOWN, SHAPES)


def with_slow() -> Whitener:
    slow = slow_errors(SIMULATOR, VALUES, SEGMENT, LEFT)
    return loosened(whitener(KNOWN, without_slow(SHAPES, slow.below)), FREE, {}, slow.response)


def flown(u: Array) -> Array:
    return SIMULATOR.run(replace(SEGMENT, u=np.column_stack([u, FLOW])), VALUES, np.zeros(2)).y


def scatter_along(operator: Whitener, signature: Array, draws: int = 300) -> float:
    """Variance of the correlation of nulls with a signature of unit white length, the initial state taken out of both: 1."""
    rng = np.random.default_rng(4)
    free = [SIMULATOR.run(SEGMENT, VALUES, x0).y for x0 in np.eye(2)]
    nulls = [flown(WRONG * rng.standard_normal(COUNT)) + NOISE * rng.standard_normal((COUNT, 2)) for _ in range(draws)]
    rows = operator.rows(np.stack([*free, signature, *nulls], axis=2))
    begun = np.linalg.qr(rows[:, :2])[0]
    rows -= begun @ (begun.T @ rows)
    return float(np.mean((rows[:, 2] @ rows[:, 3:]) ** 2) / (rows[:, 2] @ rows[:, 2]))


@pytest.mark.parametrize("begin", [6.0, 15.0, 24.0])
def test_nulls_scatter_along_slow_signatures_as_the_whitener_says(begin: float) -> None:
    signature = flown(np.where(begin < TIME, 1e-3, 0.0))
    assert scatter_along(with_slow(), signature) == pytest.approx(1.0, abs=0.25)  # of 300: three bounds


def test_a_spectrum_alone_does_not_say_it() -> None:
    signature = flown(np.where(TIME > 15.0, 1e-3, 0.0))
    assert abs(scatter_along(by_spectrum_alone(), signature) - 1.0) > 0.4


def test_the_spectrum_keeps_what_is_fast_and_the_cosines_take_the_rest() -> None:
    slow = slow_errors(SIMULATOR, VALUES, SEGMENT, LEFT)
    assert slow.response.shape == (COUNT, 2, int(2.0 * SLOW * COUNT * STEP) + 1)
    part = without_slow(SHAPES, slow.below).parts[NoisePart(NoiseSource.PREPARED, "delta_e")]
    at = np.fft.rfftfreq(COUNT, STEP)
    assert not part[at < slow.below].any()
    whole = SHAPES.parts[NoisePart(NoiseSource.PREPARED, "delta_e")]
    np.testing.assert_array_equal(part[at >= slow.below], whole[at >= slow.below])
    shown = np.sum(slow.response**2, axis=2)[
        -1, 0
    ]  # variance at the end of a record: of cosines, and of white noise below them
    draws = np.random.default_rng(1).standard_normal((400, COUNT)) * WRONG
    spectra = np.fft.rfft(draws, axis=1) * (at < slow.below)
    ends = [flown(u)[-1, 0] for u in np.fft.irfft(spectra, n=COUNT, axis=1)]
    assert shown == pytest.approx(float(np.var(ends)), rel=0.3)


def test_a_motion_that_runs_away_is_left_to_the_spectrum() -> None:
    wild = slow_errors(SIMULATOR, {**VALUES, "damp": -60.0}, replace(SEGMENT, x0=np.ones(2)), LEFT)
    assert wild.response.shape == (COUNT, 2, 0)
    assert wild.below == 0.0
    assert slow_errors(SIMULATOR, VALUES, SEGMENT, {}).response.shape[2] == 0
