"""Make the dialect definition; run as `python -m daq.contract.link.dialect.generate`.

Three sources: standard messages from the XML files that pymavlink ships, `own_messages.xml`, and the scan messages
laid out by `daq.contract.link.wire`. Two files result, both in git: `sideslip.xml`, which needs nothing else and from
which `build` makes the Python module; and `sideslip_with_standard.xml`, our messages on top of all of ArduPilot's, for
ground stations that need those (docs/mavlink.md).
"""

import sys
import xml.etree.ElementTree as ET
from importlib import import_module
from pathlib import Path
from xml.sax.saxutils import escape, quoteattr

from daq.contract.channels import BUILT_IN_CHANNELS
from daq.contract.link.dialect.build import DEFINITION
from daq.contract.link.wire import ScanLayout, layouts

HERE = Path(__file__).parent
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


def _standard_messages() -> dict[str, ET.Element]:
    folder = Path(str(import_module("pymavlink.dialects.v20").__file__)).parent
    messages = {}
    for file in ("minimal.xml", "standard.xml", "common.xml", "ardupilotmega.xml"):
        for message in ET.parse(folder / file).getroot().iter("message"):
            messages[message.attrib["name"]] = message
    return messages


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


def _layout_text(layout: ScanLayout) -> str:
    fields = "\n".join(
        f'      <field type="{f.mavlink_type}" name="{f.name}">{escape(f.meaning)}</field>' for f in layout.fields
    )
    return (
        f'    <message id="{layout.msg_id}" name="{layout.name}">\n'
        f"      <description>{escape(layout.meaning)}</description>\n{fields}\n    </message>"
    )


def main() -> int:
    """Rewrite the files."""
    DEFINITION.write_text(definition())
    WITH_STANDARD.write_text(definition_with_standard())
    print(f"{DEFINITION.name} and {WITH_STANDARD.name} written; the module follows on the next import")
    return 0


if __name__ == "__main__":
    sys.exit(main())
