"""Models over the envelope as rows of the database, as text, and as sentences; from the results of a campaign alone."""

import tomllib
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from types import MappingProxyType
from typing import TYPE_CHECKING

import numpy as np

from daq.contract.plain_words import file_name
from estimation.campaign.aerodynamics.forms import CONDITIONS
from estimation.campaign.aerodynamics.joint import curve, half_band
from estimation.campaign.aerodynamics.pooled import PooledCurves
from estimation.campaign.aerodynamics.tables import Curves, points_of
from estimation.campaign.aerodynamics.terms import derivatives_of, terms_of
from estimation.campaign.groups import Starts
from estimation.campaign.tasks import Row
from estimation.models import Model
from groundstation.flight import Array

if TYPE_CHECKING:
    import pyarrow as pa


@dataclass(frozen=True)
class JointModel:
    """A joint model out of the results. values, covariance: of `names`; about: group and method in a row."""

    model: Model
    names: tuple[str, ...]
    values: Mapping[str, float]
    covariance: Array
    flights: int
    about: Row


def joint_model_rows(results: "pa.Table", starts: Starts = MappingProxyType({})) -> Iterator[Row]:
    """A row for each group whose model over the envelope was asked for: what came of it, and what of it mixes the sides of a
    step in time (constants do not: each flight has its own). starts: of what steps moved."""
    for run in _runs(results):
        found = "model over the envelope" if run["model_text"] else "no model over the envelope"
        text = f"{run['group']}: {found} ({run['method']}): {run['why']}"
        if run["model_text"]:
            text += _mixed(Model.from_dict(tomllib.loads(run["model_text"])), run["group"], starts)
        yield {"kind": "envelope", "group": run["group"], "method": run["method"], "text": text}


def _mixed(model: Model, group: str, starts: Starts) -> str:
    """A sentence on derivatives that a step moved, by whatever method it was seen; the model has one value for both sides."""
    own = set(derivatives_of(model))
    moved = {name: at[0][0] for (label, _, name), at in sorted(starts.items()) if label == group and name in own}
    if not moved:
        return ""
    said = ", ".join(f"{name} ({date})" for name, date in moved.items())
    return (
        f"; its flights lie on both sides of a step in time that moved {said}, and it mixes them: give the sides"
        " configurations of their own"
    )


def model_texts(results: "pa.Table") -> dict[str, str]:
    """Name of a file without its ending -> TOML."""
    texts = {}
    for run in _runs(results):
        if run["model_text"]:
            texts[file_name(f"{run['group']}_{run['method']}".replace(", ", "_").replace(" ", "_"))] = run["model_text"]
    return texts


def joint_rows(results: "pa.Table", curves: Sequence[Curves]) -> list[Row]:
    """Surfaces and curves of each derivative by the joint models, at the points of the pooled curves of the same group."""
    points = {each.about["group"]: (each.about, each.envelope) for each in curves}
    rows: list[Row] = []
    for found in _found(results):
        if found.about["group"] in points:
            about, envelope = points[found.about["group"]]
            rows += _rows(found, {**about, "method": found.about["method"]}, envelope)
    return rows


def _rows(found: JointModel, about: Row, envelope: PooledCurves) -> Iterator[Row]:
    terms = terms_of(found.model)
    for name in derivatives_of(found.model):
        own = [t for t in terms if t.derivative == name]
        common: Row = {
            **about,
            "kind": "joint",
            "parameter": name,
            "flights": found.flights,
            "form": " + ".join(["1", *(f"{t.variable}^{t.power}" if t.power > 1 else t.variable for t in own)]),
        }
        for along, at in points_of(envelope):
            where = _where(at, along)
            value, std = curve(found.model, found.names, found.values, found.covariance, name, where)
            half = half_band(std, found.flights)
            for i, near in enumerate(envelope.flown(at)):
                here = {"alpha": "alpha", "V": "V", "delta_e": "delta_e", "beta_max": "beta"}
                row: Row = {**common, "along": along, "flown": bool(near)}
                row |= {column: where[i].get(v) for column, v in here.items()}
                if near:
                    ends = {"low": value[i] - half[i], "high": value[i] + half[i]}
                    row |= {n: float(x) for n, x in {"estimate": value[i], "std": std[i], **ends}.items()}
                yield row


def _where(points: Array, along: str) -> list[dict[str, float]]:
    """Values of the model's variables: sideslip is none but where it is what changes."""
    where = []
    for p in points:
        at = {n: float(x) for n, x in zip(CONDITIONS, p, strict=True) if np.isfinite(x)}
        beta = at.pop("beta_max", 0.0)
        where.append({**at, "beta": beta if along == "beta_max" else 0.0})
    return where


def _runs(results: "pa.Table") -> list[Row]:
    """Run rows of models over the envelope: no other run has a text, be it an empty one."""
    import pyarrow.compute as pc

    runs = results.filter(pc.and_(pc.equal(results["kind"], "run"), pc.is_valid(results["model_text"])))
    rows: list[Row] = runs.select(["key", "group", "method", "why", "model_text", "flights"]).to_pylist()
    return rows


def _found(results: "pa.Table") -> Iterator[JointModel]:
    import pyarrow.compute as pc

    for run in _runs(results):
        if not run["model_text"]:
            continue
        mine = results.filter(pc.and_(pc.equal(results["key"], run["key"]), pc.equal(results["kind"], "envelope")))
        rows = sorted((r for r in mine.to_pylist() if r["place"] is not None), key=lambda r: int(r["place"]))
        covariance = np.array([[np.nan if c is None else c for c in r["covariance"]] for r in rows])
        yield JointModel(
            Model.from_dict(tomllib.loads(run["model_text"])),
            tuple(r["parameter"] for r in rows),
            {r["parameter"]: r["estimate"] for r in rows},
            covariance,
            run["flights"],
            {"group": run["group"], "method": run["method"]},
        )
