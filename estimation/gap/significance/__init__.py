"""What does not fit, and how much of it chance makes: screens, nameless signals and gaps, calibrated on nulls."""
