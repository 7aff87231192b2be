"""The envelope: which quantities are watched, and what leaving their limits is called."""

import math

from daq.actuation.config import EnvelopeConfig
from daq.actuation.motion import MotionState
from daq.contract.sequencing import Reason


class FlightEnvelope:
    """Judges a motion against the configured limits; a watched quantity that is not known is a stale sensor."""

    def __init__(self, limits: EnvelopeConfig) -> None:
        bank = None if limits.bank_deg is None else (-math.radians(limits.bank_deg), math.radians(limits.bank_deg))
        alpha = (
            None if limits.alpha_deg is None else (math.radians(limits.alpha_deg[0]), math.radians(limits.alpha_deg[1]))
        )
        degree, plain = math.degrees(1.0), 1.0
        rows = (
            ("bank", bank, Reason.BANK, degree, "deg"),
            ("load_factor", limits.load_factor, Reason.LOAD_FACTOR, plain, ""),
            ("airspeed", limits.airspeed, Reason.AIRSPEED, plain, "m/s"),
            ("alpha", alpha, Reason.ALPHA, degree, "deg"),
            ("height", limits.height_m, Reason.HEIGHT, plain, "m"),
        )
        self._rows = [
            (name, limit, reason, scale, unit) for name, limit, reason, scale, unit in rows if limit is not None
        ]

    def judge(self, motion: MotionState) -> tuple[Reason, str] | None:
        """The first thing that is wrong, stale sensors before limits; None inside."""
        for name, *_ in self._rows:
            if getattr(motion, name) is None:
                return Reason.SENSOR, f"no {name.replace('_', ' ')}"
        for name, (low, high), reason, scale, unit in self._rows:
            value = getattr(motion, name)
            if not low <= value <= high:
                allowed = f"{low * scale:.3g} to {high * scale:.3g} {unit}".rstrip()
                return reason, f"{value * scale:.3g} outside {allowed}"
        return None
