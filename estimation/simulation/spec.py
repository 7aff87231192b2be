"""From the text after `--simulation` to a simulation: `jsbsim:AIRCRAFT`, `ardupilot:FILE.json`, `gazebo:FILE.sdf`,
`module:function` or `MODEL.toml`."""

from estimation.simulation.autopilot.simulations import ARDUPILOT, GAZEBO, ardupilot_simulation, gazebo_simulation
from estimation.simulation.jsbsim.aircraft import jsbsim_simulation
from estimation.simulation.jsbsim.library import PREFIX
from estimation.simulation.oracle import Simulation, SimulationError
from estimation.simulation.python_function import function_simulation
from estimation.simulation.text_model import text_simulation


def simulation_of(spec: str) -> Simulation:
    """The simulation that `spec` names. Raises SimulationError (one sentence) where there is none."""
    if spec.startswith(PREFIX):
        return jsbsim_simulation(spec.removeprefix(PREFIX))
    if spec.startswith(ARDUPILOT):
        return ardupilot_simulation(spec.removeprefix(ARDUPILOT))
    if spec.startswith(GAZEBO):
        return gazebo_simulation(spec.removeprefix(GAZEBO))
    if spec.endswith(".toml"):
        return text_simulation(spec)
    if ":" in spec:
        return function_simulation(spec)
    raise SimulationError(
        f"simulation {spec!r}: write jsbsim:AIRCRAFT (a name or a folder), ardupilot:FILE.json, gazebo:FILE.sdf,"
        " module:function, or a MODEL.toml"
    )
