"""JSBSim itself reads the tables, and gives the database's numbers back."""

from pathlib import Path

import numpy as np
import pytest

from estimation.campaign.aerodynamics.jsbsim import aerodynamics_files
from estimation.campaign.aerodynamics.tables import database_rows, envelopes
from tests.unit.estimation.campaign.aerodynamics.test_envelope_curves import SLOPES, estimates, table

AIRCRAFT = """<?xml version="1.0"?>
<fdm_config name="tables" version="2.0" release="BETA">
 <metrics>
  <wingarea unit="M2">1</wingarea> <wingspan unit="M">1.5</wingspan> <chord unit="M">0.5</chord>
  <location name="AERORP" unit="M"><x>0</x><y>0</y><z>0</z></location>
  <location name="EYEPOINT" unit="M"><x>0</x><y>0</y><z>0</z></location>
  <location name="VRP" unit="M"><x>0</x><y>0</y><z>0</z></location>
 </metrics>
 <mass_balance>
  <ixx unit="KG*M2">0.2</ixx> <iyy unit="KG*M2">0.2</iyy> <izz unit="KG*M2">0.4</izz>
  <emptywt unit="KG">3.5</emptywt> <location name="CG" unit="M"><x>0</x><y>0</y><z>0</z></location>
 </mass_balance>
 <ground_reactions/>
 AERODYNAMICS
</fdm_config>
"""


def test_jsbsim_reads_what_the_database_says(tmp_path: Path, rng: np.random.Generator) -> None:
    jsbsim = pytest.importorskip("jsbsim")
    at, values, std, _ = estimates(rng, 60, SLOPES)
    rows = database_rows(envelopes(table(at, values, std), ("aircraft",), 0), 0)
    ((name, text),) = aerodynamics_files(rows).items()
    assert name == "aircraft=cdfp_ml_pooled"
    folder = tmp_path / "aircraft" / "tables"
    folder.mkdir(parents=True)
    (folder / "tables.xml").write_text(AIRCRAFT.replace("AERODYNAMICS", text.split("?>", 1)[1]))
    fdm = jsbsim.FGFDMExec(str(tmp_path))
    fdm.set_debug_level(0)
    assert fdm.load_model("tables")
    flown = [r for r in rows if r["along"] == "alpha, V" and r["flown"]]
    for r in flown[:: len(flown) // 20]:
        fdm["ic/vt-fps"] = r["V"] / 0.3048
        fdm["ic/h-sl-ft"] = 300.0
        fdm["ic/alpha-rad"] = r["alpha"]
        assert fdm.run_ic()
        fdm["aero/alpha-rad"] = r["alpha"]
        assert fdm["velocities/vt-fps"] == pytest.approx(r["V"] / 0.3048, rel=1e-6)
        assert fdm[f"aero/sideslip/{r['parameter']}"] == pytest.approx(r["estimate"], rel=1e-4)
