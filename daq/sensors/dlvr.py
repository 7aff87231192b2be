"""DLVR: differential pressure of the pitot tube, Amphenol All Sensors, series L01D to L60D.

Data sheet DS-0300 and application note AN-DLVR as ArduPilot's driver has them (AP_Airspeed_DLVR.cpp): a plain read of four bytes
returns two status bits (00 good, 01 reserved, 10 fetched before, 11 fault), 14 bits of pressure and 11 of temperature.
Transfer functions: p = 1.25 (count - 8192) / 16384 times the span from lowest to highest; T = count*200/2047 - 50 degC.

Self-test and plausibility as of an MS4525DO, whose bytes have the same places; a pressure beyond the range is out of range.
"""

from daq.contract.scan import SensorState
from daq.sensors.base import Reading
from daq.sensors.ms4525do import JUMP_PA, Ms4525do, nominal_transfer


class Dlvr(Ms4525do):
    """Differential pressure and die temperature [counts]."""

    name, title = "dlvr", "DLVR"

    def _derive_settings(self) -> None:
        super()._derive_settings()
        scale, offset = nominal_transfer(self._config)
        self.max_step = {"pitot_pressure": JUMP_PA / scale}
        self._ends = tuple((pascal - offset) / scale for pascal in self._config.span_pa)

    def read(self) -> Reading:
        reading = super().read()
        pressure = reading.values.get("pitot_pressure")
        if pressure is None or reading.state is not SensorState.OK or self._ends[0] <= pressure <= self._ends[1]:
            return reading
        return reading._replace(state=SensorState.OUT_OF_RANGE, detail="pitot pressure beyond the sensor's range")
