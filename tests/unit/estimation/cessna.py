"""The Cessna 172 in cruise: published derivatives, and the geometry from which handbook methods are to find them.

Derivatives: Roskam, Airplane Flight Dynamics and Automatic Flight Controls, part I, table B1 (aileron turned to the sign
of this house, + rolls left). Span, area, chord, mass and inertia: the same table; tail, fin and ailerons: off a three-view.
"""

from estimation.aircraft import Aircraft
from estimation.aircraft.handbook import HandbookShape

CESSNA_172 = Aircraft("c172", 10.97, 16.17, 1.49, 1202.0, 1285.0, 1825.0, 2667.0, 0.0)
SHAPE = HandbookShape(
    speed=66.8, taper=0.68, dihedral=0.03, aileron=(0.53, 0.97), aileron_flap=0.2,
    tail_area=3.6, tail_span=3.45, tail_arm=4.6, elevator_flap=0.42,
    fin_area=1.73, fin_span=1.5, fin_arm=4.7, fin_height=0.75, rudder_flap=0.4,
)  # fmt: skip
PUBLISHED = {
    **{"CL_alpha": 4.6, "CL_de": 0.43, "Cm_alpha": -0.89, "Cm_q": -12.4, "Cm_de": -1.28},
    **{"CY_beta": -0.31, "CY_r": 0.21, "CY_dr": 0.187, "Cl_beta": -0.089, "Cl_p": -0.47, "Cl_r": 0.096},
    **{"Cl_da": -0.178, "Cl_dr": 0.0147, "Cn_beta": 0.065, "Cn_p": -0.03, "Cn_r": -0.099, "Cn_dr": -0.0657},
}
