"""PX4 ULog, read by pyulog. Series are named 'topic.field', further instances of a topic 'topic[1].field'.

Format: PX4 user guide, "ULog File Format". Topics keep their own `timestamp` [us since boot].
"""

import contextlib
import io
from pathlib import Path

import numpy as np

from daq.utilities.input_files import read_bytes
from daq.utilities.packages import missing
from daq.utilities.plain_words import LONGEST_NAME, one_line
from groundstation.flight.marks import Mark
from groundstation.importers.attitude import euler_from_quaternion
from groundstation.importers.endings import ULOG_MAGIC
from groundstation.importers.errors import ImportDataError
from groundstation.importers.formats.ulog_scan import UlogScan
from groundstation.importers.modes import mark_text, px4_marks
from groundstation.importers.series import Log, TimeSeries

_DAMAGE = (KeyError, IndexError, ValueError, TypeError, OSError, AttributeError)
"""Exceptions of pyulog on damaged bytes."""


def read_ulog(path: Path) -> Log:
    """A PX4 log: all numeric fields of all topics. Raises ImportDataError for another file, or one without data."""
    try:
        from pyulog import ULog
        from pyulog.exceptions import ULogException, ULogIncompatibleFlagException
    except ModuleNotFoundError as error:
        raise missing(error, f"{path}: a ULog") from error

    data = read_bytes(path, error=ImportDataError)
    if not data.startswith(ULOG_MAGIC):
        raise ImportDataError(f"{path}: not a ULog file (its first bytes are not 'ULog')")
    scan = UlogScan(data)
    printed = io.StringIO()
    try:
        # pyulog prints messages about damage; the notes report it instead
        with contextlib.redirect_stdout(printed):
            log = ULog(io.BytesIO(scan.stream))
    except (*_DAMAGE, ULogException, ULogIncompatibleFlagException) as error:
        raise ImportDataError(f"{path}: damaged ULog ({type(error).__name__}: {error})") from error
    series: dict[str, TimeSeries] = {}
    for topic in log.data_list:
        if "timestamp" not in topic.data:  # a damaged definition
            continue
        prefix = topic.name if topic.multi_id == 0 else f"{topic.name}[{topic.multi_id}]"
        time = np.asarray(topic.data["timestamp"], float) * 1e-6
        for field, values in topic.data.items():
            if field != "timestamp" and time.size:
                with np.errstate(invalid="ignore"):  # a signalling NaN of a damaged sample
                    series[f"{prefix}.{field}"] = TimeSeries(time, np.asarray(values, float))
        quaternion = [series[n].values for n in (f"{prefix}.q[{i}]" for i in range(4)) if n in series]
        if len(quaternion) == 4:
            series |= {f"{prefix}.{n}": TimeSeries(time, a) for n, a in euler_from_quaternion(*quaternion).items()}
    if not series:
        raise ImportDataError(f"{path}: no data in this ULog")
    notes = []
    if scan.skipped or log.file_corruption or printed.getvalue().strip():
        notes.append(f"the ULog is damaged in places ({scan.skipped} bytes); what could be read is used")
    if scan.dropouts:
        seconds = scan.dropped_ms / 1000
        notes.append(f"the logger of this ULog reports {scan.dropouts} dropouts, together {seconds:.3g} s")
    system = one_line(str(log.msg_info_dict.get("ver_sw", "")), LONGEST_NAME)
    detail = {"firmware": system} if system else {}
    marks = px4_marks(series, (Mark(t, mark_text(text)) for t, text in scan.logged))
    return Log("ulog", series, notes=tuple(notes), detail=detail, parameters=scan.parameters, marks=marks)
