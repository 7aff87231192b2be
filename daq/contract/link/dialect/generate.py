"""Make the dialect definition and the Python module from it; run as `python -m daq.contract.link.dialect.generate`.

Three sources: standard messages from the XML files that pymavlink ships, `own_messages.xml`, and the scan messages
laid out by `daq.contract.link.wire`. Three files result, all kept in the tree: `sideslip.xml`, which needs nothing else;
`sideslip_dialect.py`, made from it by pymavlink's mavgen with a table of the other standard messages' checksums
appended, so that a foreign but sound frame is told from a damaged one; and `sideslip_with_standard.xml`, our messages on
top of all of ArduPilot's, for ground stations that need those (docs/mavlink.md).
"""

import contextlib
import io
import sys
import tempfile
import xml.etree.ElementTree as ET
from importlib import import_module
from pathlib import Path
from xml.sax.saxutils import escape, quoteattr

from daq.contract.channels import BUILT_IN_CHANNELS
from daq.contract.link.wire import Layout, layouts

HERE = Path(__file__).parent
DEFINITION = HERE / "sideslip.xml"
MODULE = HERE / "sideslip_dialect.py"
WITH_STANDARD = HERE / "sideslip_with_standard.xml"
OWN = HERE / "own_messages.xml"

STANDARD = tuple(
    (
        "HEARTBEAT SYS_STATUS GPS_RAW_INT ATTITUDE COMMAND_LONG COMMAND_ACK RADIO_STATUS TIMESYNC "
        "LOG_REQUEST_LIST LOG_ENTRY LOG_REQUEST_DATA LOG_DATA LOG_ERASE LOG_REQUEST_END STATUSTEXT "
        "TUNNEL COMMAND_INT PARAM_REQUEST_READ PARAM_REQUEST_LIST PARAM_VALUE PARAM_SET PARAM_ERROR "
        "MISSION_REQUEST_LIST MISSION_COUNT MISSION_ACK MISSION_REQUEST MISSION_REQUEST_INT MISSION_CLEAR_ALL "
        "MISSION_WRITE_PARTIAL_LIST FILE_TRANSFER_PROTOCOL AUTOPILOT_VERSION HOME_POSITION "
        "VFR_HUD GLOBAL_POSITION_INT SCALED_PRESSURE AOA_SSA WIND_COV SERVO_OUTPUT_RAW BATTERY_STATUS "
        "NAMED_VALUE_FLOAT HIGH_LATENCY2"
    ).split()
)

_NOTE = "Made by daq/contract/link/dialect/generate.py from the channel table and own_messages.xml. Do not edit."


def definition() -> str:
    """The text of `sideslip.xml`."""
    standard = _standard_messages()
    parts = [_message_text(standard[name]) for name in sorted(STANDARD, key=lambda n: int(standard[n].attrib["id"]))]
    return _document("", [*parts, *_own_messages()])


def definition_with_standard() -> str:
    """The text of `sideslip_with_standard.xml`."""
    return _document("  <include>ardupilotmega.xml</include>\n", _own_messages())


def _own_messages() -> list[str]:
    scans = [_layout_text(layout) for layout in layouts(BUILT_IN_CHANNELS).values()]
    return [*scans, *(_message_text(m) for m in ET.parse(OWN).getroot())]


def _document(include: str, messages: list[str]) -> str:
    body = "\n".join(messages)
    head = (
        f'<?xml version="1.0"?>\n<!-- {_NOTE} -->\n<mavlink>\n{include}  <version>3</version>\n  <dialect>0</dialect>\n'
    )
    return f"{head}  <messages>\n{body}\n  </messages>\n</mavlink>\n"


def module_text(xml: str) -> str:
    """The text of `sideslip_dialect.py` made from a definition."""
    from pymavlink.generator import mavgen, mavparse

    with tempfile.TemporaryDirectory() as folder:
        source = Path(folder) / "sideslip.xml"
        source.write_text(xml)
        target = Path(folder) / "sideslip_dialect.py"
        options = mavgen.Opts(
            str(target), wire_protocol=mavparse.PROTOCOL_2_0, language="Python3", validate=False, strict_units=False
        )
        with contextlib.redirect_stdout(io.StringIO()):
            made = mavgen.mavgen(options, [str(source)])
        if made is False or not target.exists():
            raise RuntimeError(f"{source.name}: mavgen did not accept the definition")
        text = target.read_text()
    return text + "\n\n" + _foreign_table()


def _foreign_table() -> str:
    """Checksum seed and payload length of standard messages that the dialect does not define."""
    known = {int(m.attrib["id"]) for m in _standard_messages().values() if m.attrib["name"] in STANDARD}
    everything = import_module("pymavlink.dialects.v20.ardupilotmega").mavlink_map
    rows = {i: (t.crc_extra, t.unpacker.size) for i, t in sorted(everything.items()) if i not in known}
    lines = "\n".join(f"    {i}: {row}," for i, row in rows.items())
    return f"# Other standard messages: id -> (CRC_EXTRA, payload length)\nFOREIGN_MESSAGES = {{\n{lines}\n}}\n"


def _standard_messages() -> dict[str, ET.Element]:
    folder = Path(str(import_module("pymavlink.dialects.v20").__file__)).parent
    found = {}
    for file in ("minimal.xml", "standard.xml", "common.xml", "ardupilotmega.xml"):
        for message in ET.parse(folder / file).getroot().iter("message"):
            found[message.attrib["name"]] = message
    return found


def _message_text(message: ET.Element) -> str:
    """A message without references to enumerations, which this dialect does not define."""
    lines = [f'    <message id="{message.attrib["id"]}" name="{message.attrib["name"]}">']
    for child in message:
        if child.tag == "extensions":
            lines.append("      <extensions/>")
            continue
        keep = {k: v for k, v in child.attrib.items() if k in ("type", "name", "units")}
        attributes = "".join(f" {k}={quoteattr(v)}" for k, v in keep.items())
        text = escape(" ".join((child.text or "").split()))
        if child.tag in ("description", "field"):
            lines.append(f"      <{child.tag}{attributes}>{text}</{child.tag}>")
    return "\n".join([*lines, "    </message>"])


def _layout_text(layout: Layout) -> str:
    fields = "\n".join(
        f'      <field type="{f.mavlink_type}" name="{f.name}">{escape(f.meaning)}</field>' for f in layout.fields
    )
    return (
        f'    <message id="{layout.msg_id}" name="{layout.name}">\n'
        f"      <description>{escape(layout.meaning)}</description>\n{fields}\n    </message>"
    )


def main() -> int:
    """Rewrite the files."""
    xml = definition()
    DEFINITION.write_text(xml)
    WITH_STANDARD.write_text(definition_with_standard())
    MODULE.write_text(module_text(xml))
    print(f"{DEFINITION.name}, {WITH_STANDARD.name} and {MODULE.name} written")
    return 0


if __name__ == "__main__":
    sys.exit(main())
