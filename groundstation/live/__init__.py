"""The running ground station: one monitor for each aircraft, alarms, console, hand-over after landing."""
