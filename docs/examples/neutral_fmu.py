"""An FMU 2.0 for co-simulation, of an aircraft.json that `sideslip export --to neutral` wrote.

pip install pythonfmu; pythonfmu build -f neutral_fmu.py aircraft.json read_neutral.py
"""

import json
from pathlib import Path

from pythonfmu import Fmi2Causality, Fmi2Initial, Fmi2Slave, Real
from read_neutral import coefficients


class Aerodynamics(Fmi2Slave):
    """Inputs: the variables of the file; outputs: its coefficients, zero before the first step."""

    def __init__(self, **kwargs):
        super().__init__(**kwargs)
        self.model = json.loads((Path(__file__).parent / "aircraft.json").read_text(encoding="utf-8"))
        self.inputs = [v["name"] for v in self.model["variables"]]
        for name in self.inputs:
            setattr(self, name, 1.0 if name in ("V", "rho") else 0.0)
            self.register_variable(Real(name, causality=Fmi2Causality.input))
        for name in self.model["outputs"]:
            setattr(self, name, 0.0)
            self.register_variable(Real(name, causality=Fmi2Causality.output, initial=Fmi2Initial.exact))

    def do_step(self, current_time, step_size):
        for name, value in coefficients(self.model, **{n: getattr(self, n) for n in self.inputs}).items():
            setattr(self, name, value)
        return True
