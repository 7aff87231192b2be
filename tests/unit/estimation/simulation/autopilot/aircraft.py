"""Random aircraft for tests of exports, as files; and the textbook's accelerations, restated with nothing of the program."""

from pathlib import Path

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]
SIZES = {
    "CL_0": 0.2, "CL_alpha": 5.0, "CL_q": 6.0, "CL_de": 0.4, "CD_0": 0.03, "CD_k": 0.06, "CY_0": 0.01, "CY_beta": -0.3,
    "CY_p": 0.05,
    "CY_r": 0.2, "CY_da": 0.02, "CY_dr": 0.15, "Cl_0": 0.002, "Cl_beta": -0.06, "Cl_p": -0.45, "Cl_r": 0.1, "Cl_da": -0.12,
    "Cl_dr": 0.01, "Cm_0": 0.04, "Cm_alpha": -0.7, "Cm_q": -11.0, "Cm_de": -0.9, "Cn_0": 0.001, "Cn_beta": 0.07, "Cn_p": -0.03,
    "Cn_r": -0.09, "Cn_da": 0.01, "Cn_dr": -0.06,
}  # fmt: skip


class RandomAircraft:
    """Geometry, mass, inertia, derivatives and throws of some aeroplane of 1 to 40 kg."""

    def __init__(self, seed: int, without: tuple[str, ...] = ()) -> None:
        rng = np.random.default_rng([seed, 47])
        self.m = float(np.exp(rng.uniform(np.log(1.0), np.log(40.0))))
        self.b = float(rng.uniform(0.8, 1.2) * 1.4 * self.m**0.4)
        self.S = float(self.b**2 / rng.uniform(4.0, 12.0))
        self.c = float(self.S / self.b * rng.uniform(1.0, 1.2))
        unit = self.m * self.b**2
        self.Ixx, self.Iyy = float(unit * rng.uniform(0.015, 0.03)), float(unit * rng.uniform(0.02, 0.04))
        self.Izz = float((self.Ixx + self.Iyy) * rng.uniform(0.85, 0.97))
        self.Ixz = float(self.Ixx * rng.uniform(-0.15, 0.15))
        self.d = {k: v * rng.uniform(0.5, 1.5) for k, v in SIZES.items() if k not in without}
        self.throws = {n: float(rng.uniform(0.2, 0.6)) for n in ("delta_e", "delta_a", "delta_r")}
        self.thrust = float(self.m * rng.uniform(3.0, 12.0))

    def __getitem__(self, name: str) -> float:
        return float(self.d.get(name, 0.0))

    def toml(self, **more: float) -> str:
        """The aircraft file; more: further derivatives."""
        body = f"mass = {self.m!r}\nIxx = {self.Ixx!r}\nIyy = {self.Iyy!r}\nIzz = {self.Izz!r}\nIxz = {self.Ixz!r}"
        return (
            f'name = "random"\n[geometry]\nspan = {self.b!r}\narea = {self.S!r}\nchord = {self.c!r}\n[mass]\n{body}\n[throws]\n'
            + "".join(f"{n} = {v!r}\n" for n, v in self.throws.items())
            + f"[engine]\nstatic_thrust = {self.thrust!r}\nthrust_fall = 0.0\nlag = 0.1\n[derivatives]\n"
            + "".join(f"{n} = {float(v)!r}\n" for n, v in {**self.d, **more}.items())
        )

    def write(self, folder: Path, **more: float) -> Path:
        path = folder / "random.toml"
        path.write_text(self.toml(**more), encoding="utf-8")
        return path


def flown(seed: int, craft: RandomAircraft, count: int = 50) -> dict[str, Array]:
    """Body velocities, rates and surfaces: u, v, w, p, q, r, e, a, r_."""
    rng = np.random.default_rng([seed, 4711])
    V = np.sqrt(2.0 * craft.m * 9.81 / (1.225 * craft.S * 0.4)) * rng.uniform(0.7, 1.8, count)
    alpha, beta = rng.uniform(-0.1, 0.18, count), rng.uniform(-0.2, 0.2, count)
    x = {"u": V * np.cos(alpha) * np.cos(beta), "v": V * np.sin(beta), "w": V * np.sin(alpha) * np.cos(beta)}
    x |= {n: rng.uniform(-1.0, 1.0, count) for n in ("p", "q", "r")}
    for short, name in (("de", "delta_e"), ("da", "delta_a"), ("dr", "delta_r")):
        x[short] = rng.uniform(-1.0, 1.0, count) * craft.throws[name]
    return x


def textbook(craft: RandomAircraft, x: dict[str, Array], V: Array, rho: float, lift_of_drag: Array) -> dict[str, Array]:
    """Forces and moments with alpha = atan2(w, u), beta = atan2(v, u). lift_of_drag: what of lift pays induced drag."""
    alpha, beta = np.arctan2(x["w"], x["u"]), np.arctan2(x["v"], x["u"])
    ph, qh, rh = x["p"] * craft.b / 2 / V, x["q"] * craft.c / 2 / V, x["r"] * craft.b / 2 / V
    CL = craft["CL_0"] + craft["CL_alpha"] * alpha + craft["CL_q"] * qh + craft["CL_de"] * x["de"]
    CD = craft["CD_0"] + craft["CD_k"] * lift_of_drag**2

    def side(c: str) -> Array:
        surfaces = craft[f"{c}_da"] * x["da"] + craft[f"{c}_dr"] * x["dr"]
        return craft[f"{c}_0"] + craft[f"{c}_beta"] * beta + craft[f"{c}_p"] * ph + craft[f"{c}_r"] * rh + surfaces

    Cm = craft["Cm_0"] + craft["Cm_alpha"] * alpha + craft["Cm_q"] * qh + craft["Cm_de"] * x["de"]
    f = 0.5 * rho * V**2 * craft.S
    return {
        "X": f * (CL * np.sin(alpha) - CD * np.cos(alpha)), "Y": f * side("CY"),
        "Z": -f * (CL * np.cos(alpha) + CD * np.sin(alpha)), "L": f * craft.b * side("Cl"), "M": f * craft.c * Cm,
        "N": f * craft.b * side("Cn"),
    }  # fmt: skip
