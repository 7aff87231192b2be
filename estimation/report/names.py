"""Parameter and signal names as symbols: `Cl_beta` as C with subscripts in HTML, LaTeX and figures."""

import re

from markupsafe import Markup, escape

from daq.utilities.constants import RADIAN

_GREEK = {
    "alpha": "α",
    "beta": "β",
    "delta": "δ",
    "phi": "φ",
    "theta": "θ",
    "psi": "ψ",
    "rho": "ρ",
    "tau": "τ",
}
_SURFACES = {"da": r"\delta_a", "dr": r"\delta_r", "de": r"\delta_e"}
_DERIVATIVE = re.compile(r"^(C[A-Za-z])_(\w+)$")
_FACTOR = re.compile(r"^(d|K_|tau_)(ax|ay|az|p|q|r|alpha|beta|V|phi|theta|psi)$")


def tex(name: str) -> str:
    """LaTeX (without dollars) of a parameter or signal name; unknown names are set upright."""
    if match := _DERIVATIVE.match(name):
        axis, regressor = match.groups()
        return f"C_{{{axis[1:]}_{{{_subscript_tex(regressor)}}}}}"
    if match := _FACTOR.match(name):
        kind, signal = match.groups()
        letter = {"d": r"\Delta", "K_": "K", "tau_": r"\tau"}[kind]
        return f"{letter}_{{{_subscript_tex(signal)}}}"
    if name in _GREEK:
        return rf"\{name}"
    if name in ("delta_e", "delta_a", "delta_r"):
        return rf"\delta_{name[-1]}"
    if name in ("ax", "ay", "az"):
        return f"a_{name[1]}"
    if re.fullmatch(r"[a-zA-Z]", name):
        return name
    return rf"\mathrm{{{name.replace('_', chr(92) + '_')}}}"


def _subscript_tex(name: str) -> str:
    if name in _SURFACES:
        return _SURFACES[name]
    if name in _GREEK:
        return rf"\{name}"
    if name in ("ax", "ay", "az"):
        return f"a_{name[1]}"
    return name.replace("_", r"\_")


def html(name: str) -> Markup:
    """HTML of a parameter or signal name."""
    if match := _DERIVATIVE.match(name):
        axis, regressor = match.groups()
        return Markup("<i>C</i><sub><i>{}</i>&thinsp;{}</sub>").format(axis[1:], _subscript_html(regressor))
    if match := _FACTOR.match(name):
        kind, signal = match.groups()
        letter = {"d": "Δ", "K_": "K", "tau_": "τ"}[kind]
        return Markup("<i>{}</i><sub>{}</sub>").format(letter, _subscript_html(signal))
    return Markup("<i>{}</i>").format(_GREEK[name]) if name in _GREEK else escape(name)


def _subscript_html(name: str) -> Markup:
    if name in _SURFACES:
        return Markup("<i>δ{}</i>").format(name[1])
    return Markup("<i>{}</i>").format(_GREEK.get(name, name))


def axis_label(name: str, unit: str) -> str:
    """Label of a figure's axis: the symbol, and its unit where it has one."""
    return f"${tex(name)}$ [{literal(unit)}]" if unit else f"${tex(name)}$"


def literal(text: str) -> str:
    """Text of a figure with its dollars escaped, which would begin a formula."""
    return text.replace("$", r"\$")


def face(name: str, unit: str) -> tuple[float, str]:
    """(factor, unit) in which a signal is shown: degrees instead of radians."""
    return (RADIAN, unit.replace("rad", "deg")) if "rad" in unit else (1.0, unit)
