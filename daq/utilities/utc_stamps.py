"""A time as text in UTC: for names of folders and sessions, and for lines of a log."""

import time


def name_stamp(seconds: float) -> str:
    """Seconds since 1970 as part of a file name: 20260601T063000Z."""
    return time.strftime("%Y%m%dT%H%M%SZ", time.gmtime(seconds))


def log_stamp(seconds: float) -> str:
    """Seconds since 1970 at the head of a log line: 2026-06-01T06:30:00Z."""
    return time.strftime("%Y-%m-%dT%H:%M:%SZ", time.gmtime(seconds))
