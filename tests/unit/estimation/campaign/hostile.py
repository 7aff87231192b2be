"""An estimator that does to its worker what a flight's name says, and takes least squares for all others."""

import os
import signal
import time

from estimation.estimators.estimator import Estimator, Task
from estimation.estimators.registry import find_estimator
from estimation.estimators.result import Result


def fit(task: Task) -> Result:
    """Kill this process, sleep without end, raise what nobody expects, or fit."""
    name = task.flights[0].name
    if name.startswith("kills"):
        os.kill(os.getpid(), signal.SIGKILL)
    if name.startswith("hangs"):
        time.sleep(3600.0)
    if name.startswith("raises"):
        raise RuntimeError("on purpose")
    if name.startswith("divides"):
        raise ZeroDivisionError("by design")
    if name.startswith("slow"):
        time.sleep(float(os.environ["SLOW_S"]))
    return find_estimator("ls").fit(task).with_method("hostile")


HOSTILE = Estimator("hostile", "hostile to its worker", fit)
