"""PX4 ULog, read by pyulog. Series are named 'topic.field', further instances of a topic 'topic[1].field'.

Format: PX4 user guide, "ULog File Format". Topics keep their own `timestamp` [us since boot].
"""

import contextlib
import io
from pathlib import Path

import numpy as np

from groundstation.importers.attitude import euler_from_quaternion
from groundstation.importers.errors import ImportDataError
from groundstation.importers.series import Log, Series

_DAMAGE = (KeyError, IndexError, ValueError, TypeError, OSError, AttributeError)
"""What pyulog raises on bytes that are not what was written."""

_MAGIC = b"ULog\x01\x12\x35"


def read_ulog(path: Path) -> Log:
    """All numeric fields of all topics. Raises ImportDataError when the file is not a ULog or has no data."""
    try:
        from pyulog import ULog
        from pyulog.exceptions import ULogIncompatibleFlagException
    except ModuleNotFoundError:
        raise ImportDataError(
            f"{path}: reading ULog needs the package pyulog; pip install 'sideslip[ground]'"
        ) from None

    with path.open("rb") as handle:
        if handle.read(len(_MAGIC)) != _MAGIC:
            raise ImportDataError(f"{path}: not a ULog file (its first bytes are not 'ULog')")
    said = io.StringIO()
    try:
        # pyulog prints about damage; it is told in the notes instead
        with contextlib.redirect_stdout(said), path.open("rb") as handle:
            log = ULog(handle)
    except (*_DAMAGE, ULogIncompatibleFlagException) as error:
        raise ImportDataError(f"{path}: damaged ULog ({type(error).__name__}: {error})") from error
    series: dict[str, Series] = {}
    for topic in log.data_list:
        if "timestamp" not in topic.data:  # a damaged definition
            continue
        prefix = topic.name if topic.multi_id == 0 else f"{topic.name}[{topic.multi_id}]"
        time = np.asarray(topic.data["timestamp"], float) * 1e-6
        for field, values in topic.data.items():
            if field != "timestamp" and time.size:
                with np.errstate(invalid="ignore"):  # a signalling NaN of a damaged sample
                    series[f"{prefix}.{field}"] = Series(time, np.asarray(values, float))
        quaternion = [series.get(f"{prefix}.q[{i}]") for i in range(4)]
        if all(q is not None for q in quaternion):
            angles = euler_from_quaternion(*(q.values for q in quaternion if q is not None))
            series.update(
                {f"{prefix}.{n}": Series(time, a) for n, a in zip(("roll", "pitch", "yaw"), angles, strict=True)}
            )
    if not series:
        raise ImportDataError(f"{path}: no data in this ULog")
    notes = []
    if log.file_corruption or said.getvalue().strip():
        notes.append("the ULog is damaged in places; what could be read is used")
    lost = sum(d.duration for d in log.dropouts)
    if log.dropouts:
        notes.append(f"the logger of this ULog reports {len(log.dropouts)} dropouts, together {lost / 1000:.3g} s")
    system = str(log.msg_info_dict.get("ver_sw", ""))
    return Log("ulog", series, notes=tuple(notes), detail={"firmware": system} if system else {})
