"""The CDFP as a small mesh, in body axes x forward, y right, z down, origin at the centre of gravity [m]."""

import numpy as np
from numpy.typing import NDArray

SPAN, ROOT_CHORD, TAPER, CG_AFT_OF_NOSE = 1.50, 0.90, 0.1667, 0.44
FIN_HEIGHT, FIN_ROOT, FIN_TIP = 0.30, 0.28, 0.16
_WING, _ELEVON, _FIN = (0x9FB4C7FF, 0xE69F00FF, 0xD55E00FF)


def airframe_mesh() -> tuple[NDArray[np.float32], NDArray[np.uint32], NDArray[np.uint32]]:
    """Vertices (n, 3), triangles (m, 3) and vertex colours (n,) 0xRRGGBBAA; both faces of every plate."""
    nose = CG_AFT_OF_NOSE
    tail = nose - ROOT_CHORD
    tip_lead = tail + ROOT_CHORD * TAPER
    half = SPAN / 2
    hinge = 0.12
    plates: list[tuple[list[tuple[float, float, float]], int]] = []
    for side in (-1.0, 1.0):
        y = side * half
        plates.append(([(nose, 0.0, 0.0), (tip_lead, y, 0.0), (tail + hinge, y, 0.0), (tail + hinge, 0.0, 0.0)], _WING))
        plates.append(([(tail + hinge, 0.0, 0.0), (tail + hinge, y, 0.0), (tail, y, 0.0), (tail, 0.0, 0.0)], _ELEVON))
    fin = [(tail + FIN_ROOT, 0.0, 0.0), (tail + FIN_TIP, 0.0, -FIN_HEIGHT), (tail, 0.0, -FIN_HEIGHT), (tail, 0.0, 0.0)]
    plates.append((fin, _FIN))
    vertices = np.array([v for corners, _ in plates for v in corners], np.float32)
    colors = np.array([color for corners, color in plates for _ in corners], np.uint32)
    quads = np.arange(len(vertices)).reshape(-1, 4)
    front = np.vstack([quads[:, [0, 1, 2]], quads[:, [0, 2, 3]]])
    return vertices, np.vstack([front, front[:, ::-1]]).astype(np.uint32), colors
