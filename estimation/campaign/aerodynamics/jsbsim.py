"""The database as JSBSim functions: a table of each derivative over angle of attack and true airspeed.

For the <aerodynamics> of an aircraft, before the axes that multiply the derivatives by their angles and rates. Derivatives are
per rad, rates non-dimensional as p b / 2V, in the signs of docs/aircraft.md, which may differ from those of a JSBSim aircraft.
"""

from collections.abc import Iterator, Sequence
from xml.etree import ElementTree as ET

import numpy as np

from daq.utilities.constants import FOOT
from estimation.campaign.aerodynamics.tables import SURFACE
from estimation.campaign.groups import stem_of
from estimation.campaign.tasks import Row
from groundstation.flight import Array

FOLDER = "aero/sideslip/"
ALPHA, SPEED = "aero/alpha-rad", "velocities/vt-fps"


def aerodynamics_files(database: Sequence[Row]) -> dict[str, str]:
    """Stem of a file -> XML, for each group, method and kind of model; after the last step in time of each parameter."""
    last_date = {
        _identity(r): r["until"] for r in sorted(database, key=lambda r: r.get("until") or "") if r.get("until")
    }
    sets: dict[tuple[str, str, str], dict[str, list[Row]]] = {}
    for r in database:
        if r["along"] in (SURFACE, "") and r.get("until") in (None, last_date.get(_identity(r))):
            sets.setdefault((r["group"], r["method"], r["kind"]), {}).setdefault(r["parameter"], []).append(r)
    return {stem_of(*labels): _xml(", ".join(labels), parameters) for labels, parameters in sets.items()}


def _identity(r: Row) -> tuple[str, str, str, str]:
    return r["group"], r["method"], r["kind"], r["parameter"]


def _xml(title: str, parameters: dict[str, list[Row]]) -> str:
    root = ET.Element("aerodynamics")
    validity = "where nobody flew, as at the nearest point flown; after the last step in time"
    root.append(ET.Comment(f" Sideslip, {title}: derivatives per rad; {validity} "))
    for name, rows in parameters.items():
        root.append(_function(name, rows))
    ET.indent(root)
    return ET.tostring(root, encoding="unicode", xml_declaration=True) + "\n"


def _function(name: str, rows: Sequence[Row]) -> ET.Element:
    function = ET.Element("function", name=f"{FOLDER}{name}")
    if len(rows) == 1:
        ET.SubElement(function, "value").text = f"{rows[0]['estimate']:.8g}"
        return function
    alphas, speeds = (sorted({r[c] for r in rows}) for c in ("alpha", "V"))
    value = _filled(rows, alphas, speeds)
    table = ET.SubElement(function, "table")
    ET.SubElement(table, "independentVar", lookup="row").text = ALPHA
    ET.SubElement(table, "independentVar", lookup="column").text = SPEED
    ET.SubElement(table, "tableData").text = "\n" + "\n".join(_table_lines(alphas, speeds, value)) + "\n"
    return function


def _table_lines(alphas: Sequence[float], speeds: Sequence[float], value: Array) -> Iterator[str]:
    yield " ".join(f"{v / FOOT:.8g}" for v in speeds)
    for a, row in zip(alphas, value, strict=True):
        yield " ".join(f"{x:.8g}" for x in (a, *row))


def _filled(rows: Sequence[Row], alphas: Sequence[float], speeds: Sequence[float]) -> Array:
    """(alphas, speeds) values. JSBSim has no empty cells: where nobody flew, the nearest value, counted in steps of the grid."""
    value = np.full((len(alphas), len(speeds)), np.nan)
    for r in rows:
        if r["flown"]:
            value[alphas.index(r["alpha"]), speeds.index(r["V"])] = r["estimate"]
    filled_cells = np.argwhere(np.isfinite(value))
    for i, j in np.argwhere(np.isnan(value)):
        nearest = filled_cells[np.argmin(np.sum((filled_cells - (i, j)) ** 2, axis=1))]
        value[i, j] = value[tuple(nearest)]
    return value
