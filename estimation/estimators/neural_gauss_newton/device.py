"""Where networks are trained, and how that stays the same from run to run."""

from collections.abc import Iterator
from contextlib import contextmanager

import torch

from estimation.errors import EstimationError


def usable_device(name: str) -> str:
    """`name` if torch can compute there, `auto` meaning a GPU where there is one; EstimationError otherwise."""
    if name == "auto":
        return "cuda" if torch.cuda.is_available() else "cpu"
    try:
        device = torch.device(name)
    except RuntimeError:
        raise EstimationError(f"device {name!r} is unknown; write cpu, cuda or auto") from None
    if device.type not in ("cpu", "cuda"):
        raise EstimationError(f"device {name!r} is not supported; write cpu, cuda or auto")
    if device.type == "cuda":
        count = torch.cuda.device_count() if torch.cuda.is_available() else 0
        if not count:
            raise EstimationError(f"device {name!r}: torch finds no GPU here; write cpu or auto")
        if (device.index or 0) >= count:
            raise EstimationError(f"device {name!r}: torch finds {count} GPU here, counted from cuda:0")
    return name


@contextmanager
def one_thread() -> Iterator[None]:
    """Sums in the same order on every machine, so that the same seed gives the same bits; as it was before afterwards."""
    before = torch.get_num_threads()
    torch.set_num_threads(1)
    try:
        yield
    finally:
        torch.set_num_threads(before)
