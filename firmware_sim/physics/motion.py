"""One instant of one flight (floats) or of many (arrays): everything the equations of motion compute on the way.

Body axes x forward, y right, z down; SI and radians. `arm_*` are positions of the servo arms, where the potentiometers
sit; `surface_*` are positions of the surfaces that the air feels, which differ when a linkage gives.
"""

from typing import TYPE_CHECKING, Any


class Motion:
    """Working quantities of one evaluation of the equations of motion; attributes are set as they are computed."""

    __slots__ = tuple(
        (
            # time and rigid-body state
            "t u v w p q r e0 e1 e2 e3 north east down "
            # direction cosines NED -> body: row is the body axis
            "c11 c12 c13 c21 c22 c23 c31 c32 c33 "
            # air
            "pressure temperature rho wind_north wind_east wind_down gust_u gust_v gust_w gust_p "
            "ua va wa V alpha beta beta_dot qbar p_hat q_hat r_hat "
            # controls
            "arm_left arm_right arm_r surface_left surface_right "
            "surface_e surface_a surface_r thrust "
            # coefficients, aerodynamic and propulsive force [N] and moment [N m] about the CG
            "CL CD Cm CY Cl Cn X Y Z L M N "
            # results
            "ax ay az u_dot v_dot w_dot p_dot q_dot r_dot"
        ).split()
    )

    def __getattr__(self, name: str) -> Any:  # reached only for a quantity that has not been computed yet
        raise AttributeError(f"{name} is not known at this point of the evaluation")

    if TYPE_CHECKING:

        def __setattr__(self, name: str, value: Any) -> None: ...
