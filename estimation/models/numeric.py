"""The functions of equation text for numbers and arrays, as `expressions.evaluate` takes them."""

from collections.abc import Mapping
from typing import Any

import numpy as np

FUNCTIONS: Mapping[str, Any] = {
    "sin": np.sin, "cos": np.cos, "tan": np.tan, "asin": np.arcsin, "acos": np.arccos, "atan": np.arctan,
    "atan2": np.arctan2, "sinh": np.sinh, "cosh": np.cosh, "tanh": np.tanh, "sqrt": np.sqrt, "exp": np.exp,
    "log": np.log, "abs": np.abs, "sign": np.sign, "min": np.minimum, "max": np.maximum, "where": np.where,
}  # fmt: skip
