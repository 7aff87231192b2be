"""The work of a campaign, and who does it: this process, or the workers of a scheduler, each within its limits."""
