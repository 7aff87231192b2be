"""Models over the envelope as rows of the database, as TOML, and as sentences; all from the results of a campaign."""

import tomllib
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from types import MappingProxyType
from typing import TYPE_CHECKING

import numpy as np

from estimation.campaign.aerodynamics.forms import CONDITIONS
from estimation.campaign.aerodynamics.joint import curve, half_band
from estimation.campaign.aerodynamics.pooled import PooledCurves
from estimation.campaign.aerodynamics.tables import Curves, points_of
from estimation.campaign.aerodynamics.terms import derivatives_of, terms_of
from estimation.campaign.groups import Starts, stem_of
from estimation.campaign.tasks import Row
from estimation.models import Model
from groundstation.flight import Array

if TYPE_CHECKING:
    import pyarrow as pa


@dataclass(frozen=True)
class JointModel:
    """A joint model read from the results. values, covariance: of `names`; group_columns: group and method, as columns."""

    model: Model
    names: tuple[str, ...]
    values: Mapping[str, float]
    covariance: Array
    flights: int
    group_columns: Row


def joint_model_rows(results: "pa.Table", starts: Starts = MappingProxyType({})) -> Iterator[Row]:
    """A row for each model over the envelope: its outcome, and a warning where it mixes the sides of a step in time.

    starts: first flights after steps. Constants are not mixed: each flight has its own.
    """
    for run in _runs(results):
        outcome = "model over the envelope" if run["model_text"] else "no model over the envelope"
        text = f"{run['group']}: {outcome} ({run['method']}): {run['why']}"
        if run["model_text"]:
            text += _mixed_sides_note(Model.from_dict(tomllib.loads(run["model_text"])), run["group"], starts)
        yield {"kind": "envelope", "group": run["group"], "method": run["method"], "text": text}


def _mixed_sides_note(model: Model, group: str, starts: Starts) -> str:
    """A sentence on the derivatives that a step moved by any method: the model has one value for both sides."""
    derivative_names = set(derivatives_of(model))
    step_dates = {
        name: flights_after[0][0]
        for (label, _, name), flights_after in sorted(starts.items())
        if label == group and name in derivative_names
    }
    if not step_dates:
        return ""
    date_list = ", ".join(f"{name} ({date})" for name, date in step_dates.items())
    return (
        f"; its flights lie on both sides of a step in time that moved {date_list}, and it mixes them: give the sides"
        " configurations of their own"
    )


def model_texts(results: "pa.Table") -> dict[str, str]:
    """Stem of a file -> TOML of a model over the envelope."""
    texts = {}
    for run in _runs(results):
        if run["model_text"]:
            texts[stem_of(run["group"], run["method"])] = run["model_text"]
    return texts


def joint_rows(results: "pa.Table", curves: Sequence[Curves]) -> list[Row]:
    """Surfaces and curves of each derivative of the joint models, at the points of the pooled curves of the same group."""
    points = {
        group_curves.group_columns["group"]: (group_curves.group_columns, group_curves.envelope)
        for group_curves in curves
    }
    rows: list[Row] = []
    for joint_model in _joint_models(results):
        if joint_model.group_columns["group"] in points:
            group_columns, envelope = points[joint_model.group_columns["group"]]
            rows += _rows(joint_model, {**group_columns, "method": joint_model.group_columns["method"]}, envelope)
    return rows


def _rows(joint_model: JointModel, group_columns: Row, envelope: PooledCurves) -> Iterator[Row]:
    terms = terms_of(joint_model.model)
    for name in derivatives_of(joint_model.model):
        derivative_terms = [t for t in terms if t.derivative == name]
        common: Row = {
            **group_columns,
            "kind": "joint",
            "parameter": name,
            "flights": joint_model.flights,
            "form": " + ".join(
                ["1", *(f"{t.variable}^{t.power}" if t.power > 1 else t.variable for t in derivative_terms)]
            ),
        }
        for condition, grid in points_of(envelope):
            model_points = _model_points(grid, condition)
            value, std = curve(
                joint_model.model, joint_model.names, joint_model.values, joint_model.covariance, name, model_points
            )
            half = half_band(std, joint_model.flights)
            for i, was_flown in enumerate(envelope.flown(grid)):
                model_variables = {"alpha": "alpha", "V": "V", "delta_e": "delta_e", "beta_max": "beta"}
                row: Row = {**common, "along": condition, "flown": bool(was_flown)}
                row |= {column: model_points[i].get(v) for column, v in model_variables.items()}
                if was_flown:
                    ends = {"low": value[i] - half[i], "high": value[i] + half[i]}
                    row |= {n: float(x) for n, x in {"estimate": value[i], "std": std[i], **ends}.items()}
                yield row


def _model_points(points: Array, condition: str) -> list[dict[str, float]]:
    """Values of the model's variables at points (points, 4). Sideslip is zero unless it is the condition that varies."""
    points_of_model = []
    for p in points:
        values = {n: float(x) for n, x in zip(CONDITIONS, p, strict=True) if np.isfinite(x)}
        beta = values.pop("beta_max", 0.0)
        points_of_model.append({**values, "beta": beta if condition == "beta_max" else 0.0})
    return points_of_model


def _runs(results: "pa.Table") -> list[Row]:
    """Run rows of models over the envelope, the only ones whose `model_text` is not null."""
    import pyarrow.compute as pc

    runs = results.filter(pc.and_(pc.equal(results["kind"], "run"), pc.is_valid(results["model_text"])))
    rows: list[Row] = runs.select(["key", "group", "method", "why", "model_text", "flights"]).to_pylist()
    return rows


def _joint_models(results: "pa.Table") -> Iterator[JointModel]:
    import pyarrow.compute as pc

    for run in _runs(results):
        if not run["model_text"]:
            continue
        parameter_rows = results.filter(
            pc.and_(pc.equal(results["key"], run["key"]), pc.equal(results["kind"], "envelope"))
        )
        rows = sorted((r for r in parameter_rows.to_pylist() if r["place"] is not None), key=lambda r: int(r["place"]))
        covariance = np.array([[np.nan if c is None else c for c in r["covariance"]] for r in rows])
        yield JointModel(
            Model.from_dict(tomllib.loads(run["model_text"])),
            tuple(r["parameter"] for r in rows),
            {r["parameter"]: r["estimate"] for r in rows},
            covariance,
            run["flights"],
            {"group": run["group"], "method": run["method"]},
        )
