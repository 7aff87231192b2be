"""The engine against closed forms, finite differences, scipy and itself (compiled against virtual machine)."""

import numpy as np
import pytest
from scipy.integrate import solve_ivp
from scipy.linalg import expm

from estimation.engine.compiled import compile_kernel
from estimation.engine.compiled_library import compiler
from estimation.engine.simulate import Compile, Simulator, simulate, simulate_with_sensitivities
from estimation.engine.virtual import VirtualKernel
from estimation.errors import DataError
from estimation.models import InputTransform, Model, Parameter, Signal, load_model
from estimation.prepare.pipeline import prepare
from groundstation.flight import Flight, MissingColumnError

needs_gcc = pytest.mark.skipif(compiler() is None, reason="no gcc here")
LINEAR = Model(
    "linear",
    (Signal("x"), Signal("v")),
    (Signal("delta_a", control=True),),
    (Signal("x"), Signal("v")),
    (Parameter("k", start=-9.0), Parameter("c", start=-0.8), Parameter("b", start=2.0)),
    ("x_dot = v", "v_dot = k*x + c*v + b*delta_a"),
)


def held_record(count: int = 81, interval: float = 0.05) -> Flight:
    t = np.arange(count) * interval
    return Flight.build("made", t, {"x": np.cos(t), "v": np.sin(t), "delta_a": np.full(count, 0.3)})


def test_linear_motion_is_the_matrix_exponential() -> None:
    flight = held_record()
    A = np.array([[0.0, 1.0], [-9.0, -0.8]])
    x0, shift = np.array([0.4, -0.2]), np.array([0.3 * 2.0 / 9.0, 0.0])
    exact = np.array([expm(A * t) @ (x0 - shift) + shift for t in flight.time])
    coarse = simulate(LINEAR, flight, x0=x0, substeps=1)
    fine = simulate(LINEAR, flight, x0=x0, substeps=2)
    e1, e2 = np.abs(coarse - exact).max(), np.abs(fine - exact).max()
    assert e2 < 1e-6
    assert 12.0 < e1 / e2 < 20.0  # fourth order


def test_lateral_motion_agrees_with_an_independent_integrator(clean_flight: Flight) -> None:
    """Against another program's equations (body-axis velocities, 400 Hz); see tests/unit/estimation/truth.py."""
    from tests.unit.estimation.truth import NOISE, TRUE

    data = prepare(load_model("lateral", "cdfp"), clean_flight)
    y = simulate(load_model("lateral", "cdfp"), data, TRUE, x0=np.zeros(4), substeps=4)
    for i, name in enumerate(load_model("lateral", "cdfp").output_names):
        assert np.sqrt(np.mean((y[:, i] - clean_flight[name]) ** 2)) < 0.02 * NOISE[name]


def test_lateral_rates_agree_with_scipy(clean_flight: Flight) -> None:
    model = load_model("lateral-simple", "cdfp")
    data = prepare(model, clean_flight)
    u, t = data.segments[0].u, data.segments[0].time
    c, v = model.constants, model.starts()

    def rates(time: float, x: np.ndarray) -> list[float]:
        da, dr, V, rho = (float(np.interp(time, t, u[:, i])) for i in range(4))
        beta, p, r, phi = x
        q, ph, rh = 0.5 * rho * V * V, p * c["b"] / 2 / V, r * c["b"] / 2 / V
        CY, Cl, Cn = (
            v[f"{n}_0"] + v[f"{n}_beta"] * beta + v[f"{n}_p"] * ph + v[f"{n}_r"] * rh for n in ("CY", "Cl", "Cn")
        )
        CY, Cl, Cn = CY + v["CY_dr"] * dr, Cl + v["Cl_da"] * da + v["Cl_dr"] * dr, Cn + v["Cn_dr"] * dr
        s = q * c["S"] * c["b"] / (c["Ixx"] * c["Izz"] - c["Ixz"] ** 2)
        return [
            -r + c["g"] / V * np.sin(phi) + rho * V * c["S"] / 2 / c["m"] * CY,
            s * (c["Izz"] * Cl + c["Ixz"] * Cn),
            s * (c["Ixx"] * Cn + c["Ixz"] * Cl),
            p,
        ]

    solution = solve_ivp(rates, (0, t[-1]), np.zeros(4), "DOP853", t, rtol=1e-9, atol=1e-11, max_step=0.05)
    y = simulate(model, data, x0=np.zeros(4), substeps=8)
    assert np.abs(y[:, :4] - solution.y.T).max() < 2e-6


def wide_model() -> Model:
    """Everything an effect may bring: transforms, a lagging instrument, a late channel, a lever arm."""
    return load_model("lateral", "cdfp").plus(
        transforms=[InputTransform("delay", "delta_a", ("T_a",)), InputTransform("lag", "delta_r", ("T_r",))],
        parameters=[
            Parameter("T_a", "s", 0.031),
            Parameter("T_r", "s", 0.04),
            Parameter("T_v", "s", 0.1),
            Parameter("skew", "s", 0.023),
            Parameter("x_imu", "m", 0.1),
        ],
        states=[Signal("vane", "rad", start="beta")],
        lines=["vane_dot = (beta - vane)/T_v"],
        outputs={"beta": "vane", "ay": "ay + x_imu*r_dot"},
        output_delays={"r": "skew"},
    )


def test_sensitivities_are_derivatives_of_the_simulation(clean_flight: Flight) -> None:
    model = wide_model()
    data = prepare(model, clean_flight)
    _y, dy, dx0 = simulate_with_sensitivities(model, data, x0=np.full(5, 0.05))
    names = model.free_names
    for name in names:
        h = 1e-5
        up, down = (
            simulate(model, data, {name: model.parameter(name).start + s * h}, x0=np.full(5, 0.05)) for s in (1, -1)
        )
        difference = (up - down) / (2 * h)
        got = dy[:, :, names.index(name)]
        assert np.abs(got - difference).max() < 2e-3 * np.abs(difference).max() + 1e-9, name
    for i in range(5):
        step = np.zeros(5)
        step[i] = 1e-6
        up, down = (simulate(model, data, x0=np.full(5, 0.05) + s * step) for s in (1, -1))
        assert np.abs(dx0[:, :, i] - (up - down) / 2e-6).max() < 1e-5


@needs_gcc
@pytest.mark.parametrize("name", ["lateral", "longitudinal", "six-dof", "wide"])
def test_compiled_and_virtual_machine_agree(name: str) -> None:
    model = wide_model() if name == "wide" else load_model(name, "cdfp")
    rng = np.random.default_rng(4)
    t = np.cumsum(0.05 + 0.004 * rng.uniform(-1, 1, 30))
    columns = {n: 0.02 * rng.normal(size=30) for n in (*model.input_names, *model.output_names)}
    columns |= {
        "V": 16 + 0.1 * rng.normal(size=30),
        "rho": np.full(30, 1.17),
        "alpha": 0.1 + 0.01 * rng.normal(size=30),
    }
    data = prepare(model, Flight.build("made", t, columns))
    segment, nx, ny = data.segments[0], len(model.states), len(model.outputs)
    gain, mask = 0.002 * rng.normal(size=(nx, ny)), rng.uniform(size=(nx, ny)) < 0.3
    kernels = [compile_kernel(model.structure), VirtualKernel(model.structure)]
    for use in ((None, None), (gain, mask)):
        a, b = (
            Simulator(model, model.free_names, k).run(  # type: ignore[arg-type]
                segment, model.starts(), segment.x0, sensitivities=True, gain=use[0], gain_free=use[1]
            )
            for k in kernels
        )
        assert a.dy is not None
        assert b.dy is not None
        assert a.finite
        assert np.abs(a.y - b.y).max() <= 1e-9 * np.abs(b.y).max()
        scale = np.abs(b.dy).max(axis=(0, 1))
        assert np.all(np.abs(a.dy - b.dy).max(axis=(0, 1)) <= 1e-9 * scale + 1e-300)
    p = Simulator.build(model).vector(model.starts())
    for x, y in zip(*(k.evaluate(segment.z[:, :1] * np.ones(nx) + 0.5, segment.u, p) for k in kernels), strict=True):  # type: ignore[union-attr]
        assert np.allclose(x, y, rtol=1e-9, atol=1e-12)


def test_long_segments_pass_through_blocks_unchanged() -> None:
    rng = np.random.default_rng(0)
    t = np.arange(3000) * 0.05
    u = np.repeat(rng.normal(size=300), 10)
    flight = Flight.build("long", t, {"x": np.zeros(3000) + u, "v": u, "delta_a": u})
    data = prepare(LINEAR, flight)
    segment = data.segments[0]
    whole = Simulator(LINEAR, LINEAR.free_names, VirtualKernel(LINEAR.structure)).run(
        segment, LINEAR.starts(), np.zeros(2), sensitivities=True
    )
    half = segment.part(0, 1300, np.zeros(2))
    part = Simulator(LINEAR, LINEAR.free_names, VirtualKernel(LINEAR.structure)).run(
        half, LINEAR.starts(), np.zeros(2), sensitivities=True
    )
    assert whole.dy is not None
    assert part.dy is not None
    assert np.allclose(whole.y[:1300], part.y, rtol=1e-12)
    assert np.allclose(whole.dy[:1300], part.dy, rtol=1e-10, atol=1e-12)


@pytest.mark.parametrize("kernel", ["never", "auto"])
def test_runaway_motion_is_reported_not_raised(kernel: Compile) -> None:
    flight = held_record(400)
    simulator = Simulator.build(LINEAR.with_starts(k=40.0, c=9.0), compile_=kernel)
    motion = simulator.run(prepare(LINEAR, flight).segments[0], simulator.model.starts(), np.ones(2))
    assert not motion.finite
    assert 0 < motion.reached < 400
    assert np.all(np.isfinite(motion.y))


# ---------------------------------------------------------------------------------------------------- data


def test_missing_columns_are_named(clean_flight: Flight) -> None:
    without = {k: v for k, v in clean_flight.columns.items() if k not in ("delta_r", "theta")}
    with pytest.raises(MissingColumnError, match=r"columns delta_r, theta missing, needed for model lateral"):
        prepare(load_model("lateral", "cdfp"), Flight.build("cut", clean_flight.time, without))


def test_every_missing_column_is_named_at_once_with_the_models_that_do_without(clean_flight: Flight) -> None:
    kept = ("beta", "p", "r", "phi", "ay", "delta_a", "delta_r", "V", "rho")
    some = Flight.build("cut", clean_flight.time, {c: clean_flight.columns[c] for c in kept})
    with pytest.raises(MissingColumnError) as without_theta:
        prepare(load_model("lateral", "cdfp"), some)
    text = str(without_theta.value)
    assert "columns alpha, theta, q missing" in text
    assert text.endswith("choose a model that does without: lateral-simple")
    strange = {**{c: clean_flight.columns[c] for c in ("p", "phi")}, "AOA": clean_flight.columns["alpha"]}
    with pytest.raises(MissingColumnError) as nothing:
        prepare(load_model("lateral-simple", "cdfp"), Flight.build("cut", clean_flight.time, strange))
    text = str(nothing.value)
    assert (
        "columns delta_a, delta_r, V, beta, r, ay, rho (or p_static or altitude or altitude_gnss to derive it from) missing"
        in text
    )
    assert "choose a model" not in text
    assert "(AOA), 'sideslip import'" in text


def test_a_column_that_comes_with_another_is_not_asked_for(clean_flight: Flight) -> None:
    without = {k: v for k, v in clean_flight.columns.items() if k not in ("V", "V_dot")}
    with pytest.raises(MissingColumnError, match="column V missing"):
        prepare(load_model("lateral", "cdfp"), Flight.build("cut", clean_flight.time, without))


def test_gaps_and_holes_split_segments(clean_flight: Flight) -> None:
    keep = (clean_flight.time < 8) | (clean_flight.time > 11)
    columns = {k: v[keep].copy() for k, v in clean_flight.columns.items()}
    columns["V"][300:340] = np.nan
    columns["alpha"][50:52] = np.nan
    data = prepare(load_model("lateral", "cdfp"), Flight.build("holes", clean_flight.time[keep], columns))
    assert [(s.first, len(s)) for s in data.segments] == [(0, 160), (160, 140), (340, 200)]
    assert any("gap" in n.text for n in data.notes)
    assert any("V not measured at 40 samples" in n.text for n in data.notes)
    # 500 samples in all three
    assert any(
        n.text == "alpha not measured at 2 samples here and there (0.4%): taken on straight lines" for n in data.notes
    )
    assert not any("V not measured" in n.text and "here and there" in n.text for n in data.notes)
    assert all(np.isfinite(s.u).all() for s in data.segments)


def test_nothing_usable_is_said(clean_flight: Flight) -> None:
    columns = dict(clean_flight.columns)
    columns["q"] = np.where(np.arange(len(clean_flight)) % 5 == 0, columns["q"], np.nan)
    with pytest.raises(DataError, match="no stretch of 8 samples"):
        prepare(load_model("lateral", "cdfp"), Flight.build("holes", clean_flight.time, columns))


def test_dead_output_is_left_out_and_named(clean_flight: Flight) -> None:
    data = prepare(load_model("lateral", "cdfp"), clean_flight.with_columns(ay=np.full(len(clean_flight), 0.3)))
    assert data.absent_outputs == ("ay",)
    assert any("ay stands still at 0.3" in n.text for n in data.notes)
