"""Units in headers and mapping files, with their usual spellings, and their conversion to SI."""

from dataclasses import dataclass

from daq.utilities.constants import DEGREE as _DEG
from daq.utilities.constants import FOOT as _FOOT
from daq.utilities.constants import GRAVITY as _G
from daq.utilities.constants import KNOT as _KNOT
from daq.utilities.constants import MILE_PER_HOUR as _MPH
from daq.utilities.constants import POUND as _LBF
from daq.utilities.constants import PSI as _PSI
from daq.utilities.constants import ZERO_CELSIUS as _ZERO_C
from groundstation.importers.errors import ImportDataError


@dataclass(frozen=True, slots=True)
class Unit:
    """value in `si` = value * scale + offset."""

    si: str
    scale: float
    offset: float = 0.0


UNITS: dict[str, Unit] = {
    # angle, rate
    "rad": Unit("rad", 1.0), "deg": Unit("rad", _DEG), "mrad": Unit("rad", 1e-3), "cdeg": Unit("rad", _DEG / 100),
    "rad/s": Unit("rad/s", 1.0), "mrad/s": Unit("rad/s", 1e-3), "deg/s": Unit("rad/s", _DEG), "rpm": Unit("rad/s", 6 * _DEG),
    # acceleration
    "m/s2": Unit("m/s2", 1.0), "g": Unit("m/s2", _G), "mg": Unit("m/s2", _G / 1000), "ft/s2": Unit("m/s2", _FOOT),
    "cm/s2": Unit("m/s2", 0.01),
    # speed, length
    "m/s": Unit("m/s", 1.0), "knots": Unit("m/s", _KNOT), "km/h": Unit("m/s", 1 / 3.6), "mph": Unit("m/s", _MPH),
    "ft/s": Unit("m/s", _FOOT), "ft/min": Unit("m/s", _FOOT / 60), "cm/s": Unit("m/s", 0.01), "mm/s": Unit("m/s", 1e-3),
    "m": Unit("m", 1.0), "ft": Unit("m", _FOOT), "km": Unit("m", 1000.0), "cm": Unit("m", 0.01), "mm": Unit("m", 1e-3),
    # pressure, density, temperature
    "Pa": Unit("Pa", 1.0), "hPa": Unit("Pa", 100.0), "kPa": Unit("Pa", 1000.0), "psi": Unit("Pa", _PSI),
    "psf": Unit("Pa", _PSI / 144), "inHg": Unit("Pa", 3386.389), "mmHg": Unit("Pa", 133.322387415),
    "kg/m3": Unit("kg/m3", 1.0), "slug/ft3": Unit("kg/m3", 515.378818), "g/m3": Unit("kg/m3", 1e-3),
    "K": Unit("K", 1.0), "degC": Unit("K", 1.0, _ZERO_C), "cdegC": Unit("K", 0.01, _ZERO_C),
    "degF": Unit("K", 5 / 9, _ZERO_C - 32 * 5 / 9),
    # force, magnetic field, electricity
    "N": Unit("N", 1.0), "kgf": Unit("N", _G), "gf": Unit("N", _G / 1000), "lbf": Unit("N", _LBF), "ozf": Unit("N", _LBF / 16),
    "T": Unit("T", 1.0), "mT": Unit("T", 1e-3), "uT": Unit("T", 1e-6), "nT": Unit("T", 1e-9), "gauss": Unit("T", 1e-4),
    "mgauss": Unit("T", 1e-7), "V": Unit("V", 1.0), "mV": Unit("V", 1e-3),
    # time
    "s": Unit("s", 1.0), "ms": Unit("s", 1e-3), "us": Unit("s", 1e-6), "ns": Unit("s", 1e-9), "min": Unit("s", 60.0),
    "h": Unit("s", 3600.0), "days": Unit("s", 86400.0),
    # numbers
    "1": Unit("1", 1.0), "%": Unit("1", 0.01), "degE7": Unit("deg", 1e-7),
}  # fmt: skip

_ALIASES = {
    "°": "deg", "degree": "deg", "degrees": "deg", "radian": "rad", "radians": "rad", "°/s": "deg/s", "dps": "deg/s",
    "deg/sec": "deg/s", "rad/sec": "rad/s", "rps": "rad/s",
    "m/s^2": "m/s2", "m/s²": "m/s2", "m/s/s": "m/s2", "ms-2": "m/s2", "m s-2": "m/s2", "ft/s^2": "ft/s2", "ft/s²": "ft/s2",
    "gee": "g", "g0": "g", "kt": "knots", "kts": "knots", "kn": "knots", "knot": "knots", "kph": "km/h", "kmh": "km/h",
    "km/hr": "km/h", "mps": "m/s", "fps": "ft/s", "fpm": "ft/min", "feet": "ft", "foot": "ft", "metre": "m", "meter": "m",
    "metres": "m", "meters": "m", "mbar": "hPa", "mb": "hPa", "hpa": "hPa", "kpa": "kPa", "pa": "Pa", "inhg": "inHg",
    "kg/m^3": "kg/m3", "kg/m³": "kg/m3", "slugs/ft3": "slug/ft3", "c": "degC", "°c": "degC", "celsius": "degC", "degc": "degC",
    "f": "degF", "°f": "degF", "degf": "degF", "kelvin": "K", "k": "K", "newton": "N", "newtons": "N", "n": "N", "lb": "lbf",
    "kg": "kgf", "grams": "gf", "tesla": "T", "µt": "uT", "μt": "uT", "ut": "uT", "nt": "nT", "ga": "gauss", "mga": "mgauss",
    "volt": "V", "volts": "V", "v": "V", "mv": "mV", "sec": "s", "second": "s", "seconds": "s", "msec": "ms", "usec": "us",
    "µs": "us", "μs": "us", "minutes": "min", "percent": "%", "-": "1", "": "1", "none": "1", "1e-7deg": "degE7",
    "day": "days", "hours": "h", "hour": "h", "hr": "h",
}  # fmt: skip


def find_unit(text: str) -> Unit | None:
    """The unit that a text in any usual spelling names; None for an unknown one."""
    word = text.strip()
    for name in (word, _ALIASES.get(word, ""), _ALIASES.get(word.lower(), ""), word.lower()):
        if name in UNITS:
            return UNITS[name]
    return None


def is_unit_of(text: str, si: str) -> bool:
    """Whether a text names a unit of the dimension of `si`; False for an empty text."""
    unit = find_unit(text) if text else None
    return unit is not None and unit.si == si


def conversion(text: str, column: str, si: str) -> tuple[float, float]:
    """Scale and offset from the unit `text` to the SI unit of a flight column.

    Raises ImportDataError for an unknown unit or one of another quantity.
    """
    unit = find_unit(text)
    if unit is None:
        raise ImportDataError(f"column {column}: unit {text!r} is not known; for this column: {known_units(si)}")
    if unit.si == si:
        return unit.scale, unit.offset
    if si == "deg" and unit.si == "rad":  # latitude and longitude stay in degrees
        return unit.scale / _DEG, 0.0
    raise ImportDataError(f"column {column}: unit {text!r} is not one of {si}; for this column: {known_units(si)}")


def known_units(si: str) -> str:
    """The units that can be converted to an SI unit, as a list for a message."""
    return ", ".join(n for n, u in UNITS.items() if u.si in (si, "rad" if si == "deg" else si))
