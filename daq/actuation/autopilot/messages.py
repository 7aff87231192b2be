"""The messages exchanged with an autopilot that the dialect of the link to the ground does not have: MAVLink common.xml.

RC_CHANNELS (65): u32 time since boot [ms], 18 x u16 channel [us], u8 how many, u8 rssi. Where ArduPilot overrides a channel it
shows the override. RC_CHANNELS_OVERRIDE (70): 8 x u16, u8 system, u8 component; channels 9 to 18 are extensions. On
channels 1 to 8 a value of 0 releases and 65535 leaves alone; on 9 to 18 0 leaves alone too, so that a message without them
says nothing of them (ArduPilot, GCS_Common.cpp, handle_rc_channels_override).
"""

from collections.abc import Mapping
from dataclasses import dataclass
from struct import Struct

from daq.transport.mavlink_codec import padded

RC_CHANNELS, RC_CHANNELS_OVERRIDE = 65, 70
RELEASE, LEAVE = 0, 65535
SETTABLE = 8
"""Channels on which 0 releases."""
_CHANNELS = Struct("<I18HBB")
_OVERRIDE = Struct("<8HBB")
_ABSENT = (0, 65535)


@dataclass(frozen=True, slots=True)
class Channels:
    """The pilot's channels as the autopilot takes them, or what stands in their place.

    sampled_ns: when they were, on our clock. widths: by channel number [us]; channels that are not there are left out.
    """

    sampled_ns: int
    widths: Mapping[int, float]


def read_channels(payload: bytes) -> tuple[int, dict[int, float]]:
    """Time since boot [ms] and widths [us] of an RC_CHANNELS."""
    boot_ms, *widths, count, _ = _CHANNELS.unpack(padded(payload, _CHANNELS.size))
    return boot_ms, {i + 1: float(w) for i, w in enumerate(widths[: min(count, 18)]) if w not in _ABSENT}


def override_payload(values: Mapping[int, int], system: int) -> bytes:
    """An RC_CHANNELS_OVERRIDE to the autopilot of this system id; channels not in `values` are left alone."""
    widths = [values.get(channel, LEAVE) for channel in range(1, SETTABLE + 1)]
    return _OVERRIDE.pack(*widths, system, 1)
