"""What the CDFP is fitted with, as `daq/configs/cdfp.toml` has it."""

from daq.sensors.ads1115 import AnalogConfig
from daq.sensors.ak09916 import MagConfig
from daq.sensors.bmp390 import StaticConfig
from daq.sensors.capture import CaptureConfig
from daq.sensors.config import AttitudeConfig, SensorsConfig
from daq.sensors.icm20948 import ImuConfig
from daq.sensors.ms4525do import PitotConfig
from daq.sensors.nau7802 import ThrustConfig
from daq.sensors.ublox import GnssConfig


def cdfp_sensors() -> SensorsConfig:
    """The CDFP's full fit at its default addresses and ranges."""
    return SensorsConfig(
        imu=ImuConfig(),
        mag=MagConfig(),
        attitude=AttitudeConfig(),
        analog_a=AnalogConfig(address=0x48),
        analog_b=AnalogConfig(address=0x49),
        analog_c=AnalogConfig(address=0x4A, required=False),
        pitot=PitotConfig(),
        static=StaticConfig(),
        thrust=ThrustConfig(required=False),
        capture=CaptureConfig(),
        gnss=GnssConfig(required=False),
    )
