"""What can be wrong with a request to the simulator."""

from daq.contract.errors import UserError


class ScenarioError(UserError):
    """A scenario that cannot be flown: unknown name, malformed TOML, impossible or unknown key."""
