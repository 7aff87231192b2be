"""A rerun recording as a file that is whole or not at all.

rerun's own file sink says nothing when the disk is full, and then waits for ever; so its bytes come here and are written as
any other file is.
"""

from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import TYPE_CHECKING, Any

from daq.contract.durable import write_bytes

if TYPE_CHECKING:
    import rerun as rr


@contextmanager
def rerun_file(stream: "rr.RecordingStream", path: Path, blueprint: Any) -> Iterator[None]:
    """Everything logged to `stream` inside goes to `path` at the end; blueprint: its layout. OSError names the file.

    It is held in memory until then, some 10 bytes a value: each reading of rerun's stream is a recording of its own.
    """
    encoded = stream.binary_stream()
    try:
        stream.send_blueprint(
            blueprint
        )  # active: the stream names its recording first, and a viewer would lay that out by itself
        yield
        write_bytes(path, encoded.read() or b"")
    finally:
        stream.disconnect()
