"""XML from untrusted files, within limits: no document type, no entities, limited bytes, elements and levels."""

from pathlib import Path
from xml.etree import ElementTree as ET
from xml.parsers import expat

from daq.utilities.input_files import read_bytes
from estimation.simulation.oracle import SimulationError

LARGEST = 4 * 2**20  # bytes; models of PX4 have some 20 kB
DEEPEST = 64  # nested elements; SDF needs ten
MOST_ELEMENTS = 50_000  # elements; models of PX4 have some hundreds


def bounded_tree(path: Path, what: str, most: int = LARGEST) -> ET.Element:
    """The root of an XML file. what: its kind, for messages; most: bytes. Raises SimulationError for no XML, or beyond limits."""
    data = read_bytes(path, what, SimulationError, most)
    builder = ET.TreeBuilder()
    depth = count = 0

    def start(tag: str, attributes: dict[str, str]) -> None:
        nonlocal depth, count
        depth, count = depth + 1, count + 1
        if depth > DEEPEST or count > MOST_ELEMENTS:
            raise SimulationError(
                f"{path}: more than {DEEPEST} levels or {MOST_ELEMENTS} elements; {what} has no need of them"
            )
        builder.start(tag, attributes)

    def end(tag: str) -> None:
        nonlocal depth
        depth -= 1
        builder.end(tag)

    def doctype(*_: object) -> None:
        raise SimulationError(f"{path}: declares a document type, which {what} has no need of; remove it")

    parser = expat.ParserCreate()
    parser.buffer_text = True
    parser.StartElementHandler, parser.EndElementHandler = start, end
    parser.CharacterDataHandler = builder.data
    parser.StartDoctypeDeclHandler = doctype
    try:
        parser.Parse(data, True)
    except (expat.ExpatError, ValueError, LookupError) as error:
        raise SimulationError(f"{path}: no XML ({error})") from error
    return builder.close()
