"""What a parameter is for is said by its role, never guessed from how somebody named it."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from estimation.aircraft import load_aircraft
from estimation.engine.simulate import simulate
from estimation.errors import ModelError
from estimation.estimators.output_error import output_error
from estimation.models import Model, Parameter, ParameterRole, load_model, read_model, write_model
from estimation.models.base import joint_model
from estimation.models.kinematic import FACTORS, compatibility_model
from estimation.prepare.pipeline import prepare
from estimation.report.drawing.estimate_figures import scatter_figure
from estimation.session import runner
from groundstation.flight import Flight
from tests.unit.estimation.truth import TRUE

LATERAL = load_model("lateral", "cdfp")
OWN_NAMES = ("bias_x", "timing_x", "edge_x", "plumb_x", "rounding_x")


def with_own_names() -> Model:
    """The lateral model with five derivatives under names that other programs give to nuisances."""
    renamed = dict(zip(("Cl_beta", "Cl_p", "Cl_da", "Cn_beta", "Cn_r"), OWN_NAMES, strict=True))
    lines = []
    for line in LATERAL.equations:
        for old, new in renamed.items():
            line = line.replace(f"{old}*", f"{new}*")
        lines.append(line)
    parameters = tuple(
        replace(p, name=renamed.get(p.name, p.name), role=ParameterRole.DERIVATIVE) if p.name in renamed else p
        for p in LATERAL.parameters
    )
    return replace(LATERAL, name="own", equations=tuple(lines), parameters=parameters)


def test_a_persons_bias_x_is_estimated_reported_and_judged_like_any_other(
    made_flights: list[Flight], tmp_path: Path
) -> None:
    write_model(with_own_names(), tmp_path / "own.toml")
    own = read_model(tmp_path / "own.toml")
    assert all(own.parameter(n).role is ParameterRole.DERIVATIVE for n in OWN_NAMES)
    session = runner.estimate(own, made_flights[:1], load_aircraft("cdfp"))
    plain = runner.estimate(LATERAL, made_flights[:1], load_aircraft("cdfp"))
    there = dict(zip(OWN_NAMES, ("Cl_beta", "Cl_p", "Cl_da", "Cn_beta", "Cn_r"), strict=True))
    for name, other in there.items():
        mine, usual = (s.flights[0].results["ml"].parameters[n] for s, n in ((session, name), (plain, other)))
        assert mine.identifiable
        assert mine.estimate == pytest.approx(usual.estimate, rel=1e-6)
        assert mine.std_coloured == pytest.approx(usual.std_coloured, rel=1e-6)
        assert session.mean["ml"][name].mean == pytest.approx(plain.mean["ml"][other].mean, rel=1e-6)
        assert not session.mean["ml"][name].trim
    assert not {p.name for p in joint_model(own).parameters if p.local} & set(OWN_NAMES)
    assert scatter_figure(session).height == scatter_figure(plain).height  # as many panels


def with_roles(model: Model, **roles: ParameterRole) -> Model:
    return model.plus(parameters=[replace(model.parameter(name), role=role) for name, role in roles.items()])


def test_constants_are_each_flights_own_by_their_role(made_flights: list[Flight]) -> None:
    assert LATERAL.free_of(ParameterRole.CONSTANT) == ("CY_0", "Cl_0", "Cn_0")
    shared = with_roles(LATERAL, CY_0=ParameterRole.DERIVATIVE, CY_dr=ParameterRole.CONSTANT)
    assert [p.name for p in joint_model(shared).parameters if p.local] == ["CY_dr", "Cl_0", "Cn_0"]
    assert load_model("longitudinal", "cdfp").free_of(ParameterRole.CONSTANT) == (
        "CL_0",
        "Cm_0",
    )  # CD_0 is a derivative


def test_roles_go_through_a_file_and_unknown_ones_are_refused(tmp_path: Path) -> None:
    model = with_roles(LATERAL.with_biases("p"), Cl_p=ParameterRole.NUISANCE, CY_0=ParameterRole.DERIVATIVE)
    write_model(model, tmp_path / "m.toml")
    text = (tmp_path / "m.toml").read_text()
    assert text.count("role = ") == 3  # the usual ones go without saying
    again = read_model(tmp_path / "m.toml")
    assert again.parameters == model.parameters
    assert again.parameter("bias_p").role is ParameterRole.INSTRUMENT
    (tmp_path / "m.toml").write_text(text.replace('role = "nuisance"', 'role = "nuisence"'))
    with pytest.raises(ModelError, match=r"'Cl_p': role = 'nuisence' is none of derivative, constant, instrument"):
        read_model(tmp_path / "m.toml")


def test_a_bias_never_takes_the_place_of_a_persons_parameter(clean_flight: Flight) -> None:
    own = LATERAL.plus(
        terms={"Cn": "bias_p*beta*beta"}, parameters=[Parameter("bias_p", "1/rad2", start=0.02)], name="own"
    )
    with pytest.raises(ModelError, match="model own: it already has a parameter bias_p"):
        own.with_biases("p")
    both = own.with_biases("r")
    truth = simulate(own, prepare(LATERAL, clean_flight), {**own.starts(), **TRUE, "bias_p": 0.05})
    columns = {s.source: truth[:, i] for i, s in enumerate(own.outputs)}
    told = output_error(both, clean_flight.with_columns(**columns)).parameters
    assert told["bias_p"].estimate == pytest.approx(0.05, rel=1e-5)
    assert abs(told["bias_r"].estimate) < 1e-3


def test_every_factor_of_the_compatibility_check_is_an_instruments() -> None:
    model = compatibility_model(("dax", "K_beta", "x_vane", "tau_phi"))
    assert {p.role for p in model.parameters} == {ParameterRole.INSTRUMENT}
    assert model.output_delays == {"phi": "tau_phi"}
    assert FACTORS["dV"].channels == ("V",)  # and not a specific force, though its name begins like dax
    assert FACTORS["day"].channels == ("V", "alpha", "beta")
    assert FACTORS["dp"].channels == ()
    assert np.isfinite([f.parameter.start for f in FACTORS.values()]).all()
