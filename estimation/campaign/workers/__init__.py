"""The work of a campaign, and where it runs: in this process or on the workers of a scheduler, within limits of time."""
