"""ArduPilot dataflash (.bin), read by pymavlink. Series are named 'MESSAGE.field', further instances 'MESSAGE[1].field'.

Format: ArduPilot developer guide, "Log messages"; each file describes its own messages (FMT, FMTU). Time is TimeUS.
"""

from pathlib import Path

import numpy as np

from groundstation.importers.errors import ImportDataError
from groundstation.importers.series import Log, Series

_HEAD = b"\xa3\x95"


def read_dataflash(path: Path) -> Log:
    """All numeric fields of all timed messages. Raises ImportDataError when the file is not a dataflash log."""
    from pymavlink import DFReader

    with path.open("rb") as handle:
        if handle.read(2) != _HEAD:
            raise ImportDataError(f"{path}: not an ArduPilot dataflash log (it does not begin with a message head)")
    collected: dict[str, tuple[list[float], dict[str, list[float]]]] = {}
    try:
        reader = DFReader.DFReader_binary(str(path), zero_time_base=True)
        while (message := reader.recv_msg()) is not None:
            _collect(message, collected)
    except (ValueError, KeyError, IndexError, TypeError, OSError) as error:
        raise ImportDataError(f"{path}: damaged dataflash log ({type(error).__name__}: {error})") from error
    finally:
        if "reader" in locals():
            reader.close()
    series = {
        f"{message}.{field}": Series(np.array(time), np.array(values))
        for message, (time, fields) in collected.items()
        for field, values in fields.items()
        if len(values) == len(time)
    }
    if not series:
        raise ImportDataError(f"{path}: no timed messages in this dataflash log")
    for name in [n for n in series if n.endswith(".Spd") and n.startswith("GPS")]:
        _velocity(name.rsplit(".", 1)[0], series)
    return Log("dataflash", series)


def _collect(message: object, collected: dict[str, tuple[list[float], dict[str, list[float]]]]) -> None:
    fields = message.to_dict()  # type: ignore[attr-defined]
    if "TimeUS" not in fields:
        return
    name = str(fields["mavpackettype"])
    instance = getattr(getattr(message, "fmt", None), "instance_field", None)
    if instance is not None and fields.get(instance):
        name = f"{name}[{fields[instance]}]"
    time, columns = collected.setdefault(name, ([], {}))
    time.append(float(fields["TimeUS"]) * 1e-6)
    for key, value in fields.items():
        if key not in ("TimeUS", "mavpackettype") and isinstance(value, (int, float)):
            columns.setdefault(key, []).append(float(value))


def _velocity(prefix: str, series: dict[str, Series]) -> None:
    """North and east velocity from ground speed and course [deg]."""
    speed, course = series.get(f"{prefix}.Spd"), series.get(f"{prefix}.GCrs")
    if speed is not None and course is not None:
        angle = np.deg2rad(course.values)
        series[f"{prefix}.VN"] = Series(speed.time, speed.values * np.cos(angle))
        series[f"{prefix}.VE"] = Series(speed.time, speed.values * np.sin(angle))
