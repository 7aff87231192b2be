"""Simulated chips that a laboratory brings for sensors of its own, found by the entry point group `sideslip.chips`.

The name of an entry point is the sensor group, its value `module:make`; `make(instruments)` returns the chip, which sits at
the address that `[sensors.extra.GROUP]` of the logger's configuration says (docs/sensors.md).
"""

from collections.abc import Mapping
from importlib.metadata import entry_points

from daq.sensors.config import ExtraConfig
from firmware_sim.hardware.registers.chip import PoweredChip
from firmware_sim.hardware.sensing.instruments import Instruments
from firmware_sim.tables import ScenarioError

ENTRY_POINTS = "sideslip.chips"


def laboratory_chips(extra: Mapping[str, ExtraConfig], instruments: Instruments) -> dict[int, PoweredChip]:
    """Chips by bus address for the sensors of one's own that have one; a sensor without one is absent in flight.

    Raises ScenarioError for a chip that cannot be had or whose address the configuration does not say.
    """
    chips: dict[int, PoweredChip] = {}
    for group, section in extra.items():
        for entry in entry_points(group=ENTRY_POINTS, name=group):
            if section.address is None:
                raise ScenarioError(f"sensors.extra.{group}: its simulated chip needs an address; add the key address")
            try:
                chips[section.address] = entry.load()(instruments)
            except (ImportError, AttributeError, TypeError) as error:
                raise ScenarioError(
                    f"entry point {ENTRY_POINTS} {group} = {entry.value}: no simulated chip there ({error})"
                ) from error
    return chips
