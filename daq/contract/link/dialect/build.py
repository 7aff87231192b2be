"""Builds the Python module of the dialect from `sideslip.xml` with pymavlink's mavgen.

The module is not in git: a wheel contains it, an editable install writes it into the source tree (`setup.py` calls this file for
both), and a source tree without it, or with a newer XML, writes it on first use. The checksums of the other standard messages are
appended, so that a valid frame of another dialect can be distinguished from a damaged one. Only building imports more than the
standard library.
"""

import contextlib
import io
import os
import tempfile
import zlib
from pathlib import Path

HERE = Path(__file__).parent
DEFINITION = HERE / "sideslip.xml"
MODULE = "sideslip_dialect.py"


def ensure_module() -> None:
    """Build the module beside the definition unless there is a complete one of this definition.

    Raises ImportError, with the remedy, where it is missing and the folder cannot be written.
    """
    module = HERE / MODULE
    mark = _mark(DEFINITION.read_bytes()).encode()
    with contextlib.suppress(OSError), module.open("rb") as stream:
        if stream.readline() == mark and stream.seek(-len(mark), os.SEEK_END) and stream.read() == mark:
            return
    try:
        write_module(HERE)
    except OSError as error:
        raise ImportError(
            f"{module}: the MAVLink dialect is not built and cannot be written ({error.strerror}); install the package with pip"
        ) from error


def write_module(folder: Path) -> Path:
    """Write the module into `folder` atomically; several processes may do so at once. Returns its path."""
    text = module_text(DEFINITION.read_bytes())
    with tempfile.NamedTemporaryFile("wb", dir=folder, prefix=".dialect", suffix=".tmp", delete=False) as stream:
        try:
            stream.write(text.encode())
            stream.flush()
            os.fsync(stream.fileno())
            Path(stream.name).chmod(0o644)
            return Path(stream.name).replace(folder / MODULE)
        except BaseException:
            Path(stream.name).unlink(missing_ok=True)
            raise


def module_text(definition: bytes) -> str:
    """The text of the module for a definition; first and last line identify the definition."""
    from pymavlink.generator import mavgen, mavparse

    with tempfile.TemporaryDirectory() as folder:
        source, target = Path(folder) / "sideslip.xml", Path(folder) / MODULE
        source.write_bytes(definition)
        options = mavgen.Opts(
            str(target), wire_protocol=mavparse.PROTOCOL_2_0, language="Python3", validate=False, strict_units=False
        )
        with contextlib.redirect_stdout(io.StringIO()):
            accepted = mavgen.mavgen(options, [str(source)])
        if accepted is False or not target.exists():
            raise RuntimeError(f"{source.name}: mavgen did not accept the definition")
        messages = {message.id for message in mavparse.MAVXML(str(source), mavparse.PROTOCOL_2_0).message}
        mark = _mark(definition)
        return f"{mark}{target.read_text('utf-8')}\n\n{_foreign_table(messages)}{mark}"


def _mark(definition: bytes) -> str:
    return f"# Made from sideslip.xml, crc32 {zlib.crc32(definition):08x}, by build.py. Not in git.\n"


def _foreign_table(defined: set[int]) -> str:
    """Checksum seed and payload length of standard messages that the dialect does not define."""
    from pymavlink.dialects.v20.ardupilotmega import mavlink_map

    rows = {i: (t.crc_extra, t.unpacker.size) for i, t in sorted(mavlink_map.items()) if i not in defined}
    lines = "\n".join(f"    {i}: {row}," for i, row in rows.items())
    return f"# Other standard messages: id -> (CRC_EXTRA, payload length)\nFOREIGN_MESSAGES = {{\n{lines}\n}}\n"
