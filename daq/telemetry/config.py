"""`[downlink]`: the radio link as the aircraft's configuration describes it.

The default byte budget is what a SiK radio at 57600 baud, air rate 64 kbit/s, error correction on, carries in a fair
half of its air time (1636 bytes/s): 11.5 signed scan frames a second, the heartbeat, and the slow messages at about
1 Hz fit in it with nothing to spare.
"""

from pathlib import Path
from typing import Annotated

from pydantic import BaseModel, ConfigDict, Field, model_validator

SCAN_FRAME_BYTES = 118
"""Largest scan frame on the wire: 93 bytes of payload, 12 of framing, 13 of signature."""
HEARTBEAT_BYTES = 34
MIN_RATE_HZ = 2.0
"""Lowest rate of scans while the downlink is on, whatever the radio reports."""


Count = Annotated[float, Field(ge=-(2.0**31), le=2.0**32, allow_inf_nan=False)]
"""A value of a raw channel."""
Slope = Annotated[float, Field(ge=-1e4, le=1e4, allow_inf_nan=False)]
"""A scale per count; the bounds keep the product within the fields of the messages."""


class LinkLimits(BaseModel):
    """`[downlink.limits]`: limits of requests from the ground. Requests beyond them are refused, counted and reported."""

    model_config = ConfigDict(extra="forbid", frozen=True)

    requests_per_s: Annotated[float, Field(gt=0, le=1000)] = 50.0  # of one sender; twice that for all senders together
    recording_s: Annotated[float, Field(ge=0, le=3600)] = 10.0  # shortest recording begun by command
    recordings: Annotated[int, Field(ge=0, le=10_000)] = 100  # begun by command, until the logger is started again
    marks_per_s: Annotated[float, Field(gt=0, le=100)] = 1.0  # events marked by command, in the long run
    marks_at_once: Annotated[int, Field(ge=1, le=100)] = 5


class DisplayConfig(BaseModel):
    """`[downlink.display]`: nominal scales of the air data that standard ground stations display.

    From data sheets and the installation drawing; a quantity without them is not sent. They do not affect what is recorded,
    calibrated or estimated.
    """

    model_config = ConfigDict(extra="forbid", frozen=True)

    pitot_zero_count: Count | None = None  # count at no airspeed; zeroing the pitot by command replaces it
    pitot_pa_per_count: Slope | None = None
    alpha_zero_count: Count | None = None  # count of the vane at no angle
    alpha_rad_per_count: Slope | None = None  # + nose up
    beta_zero_count: Count | None = None
    beta_rad_per_count: Slope | None = None  # + wind from the right
    # Supply of the vanes at which their numbers hold; None for vanes that do not depend on it.
    sensor_supply_count: Annotated[Count, Field(gt=0)] | None = None


class DownlinkConfig(BaseModel):
    """`[downlink]`: what is sent to the ground, at which rates, and with which key commands are signed.

    port: `serial:/dev/ttyUSB0:57600`, `udp:HOST:PORT` (sends there), `udpin:HOST:PORT` (answers the first sender),
    `tcp:HOST:PORT` or `tcpin:HOST:PORT`.
    """

    model_config = ConfigDict(extra="forbid", frozen=True, allow_inf_nan=False)

    port: str = ""
    rate_hz: Annotated[float, Field(ge=MIN_RATE_HZ, le=100)] = 11.5
    budget_bytes_per_s: Annotated[float, Field(gt=0)] = 1636.0
    system_id: Annotated[int, Field(ge=1, le=250)] = 1
    # MAV_COMP_ID_ONBOARD_COMPUTER, beside an autopilot of the same system. QGroundControl shows only component 1 as an aircraft:
    # write 1 where no autopilot sends.
    component_id: Annotated[int, Field(ge=1, le=250)] = 191
    data_component_id: Annotated[int, Field(ge=1, le=250)] = (
        192  # of Sideslip's own messages, with a sequence of their own
    )
    slow_rate_hz: Annotated[float, Field(gt=0, le=20)] = 1.0
    gnss_rate_hz: Annotated[float, Field(gt=0, le=20)] = 1.0
    # For standard ground stations only: in all some 120 bytes/s signed, within what the default budget leaves (docs/link.md).
    attitude_rate_hz: Annotated[float, Field(gt=0, le=20)] = 0.4
    display_rate_hz: Annotated[float, Field(gt=0, le=20)] = 0.4  # VFR_HUD, AOA_SSA, GLOBAL_POSITION_INT
    gps_raw_rate_hz: Annotated[float, Field(gt=0, le=20)] = 0.2
    sys_status_rate_hz: Annotated[float, Field(gt=0, le=20)] = 0.2
    extra_rate_hz: Annotated[float, Field(gt=0, le=20)] = 0.1  # SCALED_PRESSURE, SERVO_OUTPUT_RAW, battery, wind
    statistics_rate_hz: Annotated[float, Field(gt=0, le=20)] = 0.2
    supply_volts_per_count: Slope | None = None  # for SYS_STATUS and BATTERY_STATUS only; None: voltage is unknown
    display: DisplayConfig = DisplayConfig()
    key_file: Path | None = None  # 32 bytes or 64 hexadecimal digits, mode 0600; with it unsigned commands do nothing
    signing_state: Path | None = None  # where the signing timestamps survive a restart; default beside the key
    backfill_memory_mb: Annotated[float, Field(gt=0)] = 64.0  # scans kept compressed in memory for late requests
    limits: LinkLimits = LinkLimits()
    scan_queue: Annotated[int, Field(ge=1, le=1000)] = (
        4  # scan frames waiting for the port before the oldest is dropped
    )

    @model_validator(mode="after")
    def _fits_budget(self) -> "DownlinkConfig":
        limit_hz = max_rate(self.budget_bytes_per_s)
        if self.rate_hz > limit_hz:
            raise ValueError(
                f"rate_hz {self.rate_hz:g} needs {self.rate_hz * SCAN_FRAME_BYTES + HEARTBEAT_BYTES:.0f} bytes/s; "
                f"budget_bytes_per_s {self.budget_bytes_per_s:g} allows at most {limit_hz:.1f} Hz"
            )
        return self


def max_rate(budget_bytes_per_s: float) -> float:
    """Scan frames a second [Hz] that a byte budget [bytes/s] carries beside the heartbeat."""
    return (budget_bytes_per_s - HEARTBEAT_BYTES) / SCAN_FRAME_BYTES
