"""What both clients of an autopilot share: who asks (the sequencer's overrides, the sensors' samples), for what, and how often.

MAVLink common.xml. ArduPilot sends a message at 0.8 of its loop rate at most (GCS_Common.cpp, cap_message_interval).
"""

import math

COMPONENT, AUTOPILOT = 191, 1  # MAV_COMP_ID_ONBOARD_COMPUTER asks MAV_COMP_ID_AUTOPILOT1
REQUEST_AGAIN_NS = 300_000_000  # after which a request without an answer counts as lost
CLOCK_DRIFT = 100e-6  # of the autopilot's clock against ours: twice what a crystal has
LARGEST_LOOP_SHARE = 0.8
SLOW_SHARE = 0.9  # of the requested rate: below, a message comes too seldom and is requested again


def is_slow(rate_hz: float, interval_us: int) -> bool:
    """Whether a message comes too seldom for the interval [us] that was requested."""
    return rate_hz < SLOW_SHARE * 1e6 / interval_us


def least_loop_rate(rate_hz: float) -> int:
    """The least SCHED_LOOP_RATE [Hz] at which ArduPilot grants a message rate [Hz]."""
    return math.ceil(rate_hz / LARGEST_LOOP_SHARE)
