"""A flight in turns with exact kinematics, wind and noise, for what needs motion that agrees with itself but no model."""

import numpy as np

Columns = dict[str, np.ndarray]
GRAVITY = 9.80665
RHO = 1.104


def turning_flight(seed: int = 5, hz: float = 25.0, seconds: float = 50.0, sway: float = 0.0) -> Columns:
    """Left and right turns at 21 m/s in a wind of 6 m/s, kinematics exact by differences, noise on every channel.

    sway: amplitude [rad] of faster motion in bank, and of a third of it in pitch and heading."""
    rng = np.random.default_rng(seed)
    t = np.arange(0.0, seconds, 1 / hz)
    psi = 0.7 + 1.9 * np.sin(0.17 * t)
    theta, phi = 0.05 + 0.03 * np.sin(0.6 * t), np.arctan(21.0 * 0.323 * np.cos(0.17 * t) / GRAVITY)
    phi = phi + sway * np.sin(2.3 * t)
    theta, psi = theta + sway / 3.0 * np.sin(1.7 * t), psi + sway / 3.0 * np.sin(1.9 * t)
    speed = 21.0 + 0.8 * np.sin(0.3 * t)
    climb = speed * np.sin(theta - 0.05)
    flat = np.sqrt(speed**2 - climb**2)
    v = np.array([flat * np.cos(psi) + 4.1, flat * np.sin(psi) - 4.4, -climb])
    a = np.gradient(v, t, axis=1) - np.array([[0.0], [0.0], [GRAVITY]])
    c, s = np.cos, np.sin
    rows = np.array([
        [c(theta) * c(psi), c(theta) * s(psi), -s(theta)],
        [s(phi) * s(theta) * c(psi) - c(phi) * s(psi), s(phi) * s(theta) * s(psi) + c(phi) * c(psi), s(phi) * c(theta)],
        [c(phi) * s(theta) * c(psi) + s(phi) * s(psi), c(phi) * s(theta) * s(psi) - s(phi) * c(psi), c(phi) * c(theta)],
    ])  # fmt: skip
    force = np.einsum("ijn,jn->in", rows, a)
    dphi, dtheta, dpsi = (np.gradient(x, t) for x in (phi, theta, psi))
    p, q, r = (
        dphi - s(theta) * dpsi,
        c(phi) * dtheta + s(phi) * c(theta) * dpsi,
        -s(phi) * dtheta + c(phi) * c(theta) * dpsi,
    )
    field = np.einsum("ijn,j->in", rows, [2.1e-5, 1e-6, 4.3e-5])
    true = {
        "ax": force[0], "ay": force[1], "az": force[2], "p": p, "q": q, "r": r, "phi": phi, "theta": theta,
        "psi": (psi + np.pi) % (2 * np.pi) - np.pi, "V": speed, "vn": v[0], "ve": v[1], "vd": v[2],
        "p_dynamic": 0.5 * RHO * speed**2, "p_static": np.full(t.size, RHO * 287.05 * 281.0),
        "temperature": np.full(t.size, 281.0), "mx": field[0], "my": field[1], "mz": field[2],
    }  # fmt: skip
    noise = {"ax": 0.1, "ay": 0.1, "az": 0.1, "p": 0.005, "q": 0.005, "r": 0.005, "V": 0.2, "vn": 0.1, "ve": 0.1, "vd": 0.1,
             "p_dynamic": 2.0, "p_static": 8.0, "mx": 3e-7, "my": 3e-7, "mz": 3e-7}  # fmt: skip
    return {"time": t, **{n: x + noise.get(n, 0.002) * rng.standard_normal(t.size) for n, x in true.items()}}
