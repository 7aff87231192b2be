"""The verb `ground`: the ground station's own command, told how aircraft files are read."""

import copy

from groundstation.cli import live
from sideslip.live_aircraft import live_aircraft

ground = copy.copy(live.ground)
ground.context_settings = {**live.ground.context_settings, "obj": live_aircraft}
