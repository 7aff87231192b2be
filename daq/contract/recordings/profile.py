"""Who wrote an MCAP file: the profile in its header (MCAP specification, mcap.dev)."""

from pathlib import Path

OURS = "sideslip"  # profile of the recordings and flights that this program writes
_MAGIC = b"\x89MCAP0\r\n"
_HEADER_OPCODE, _HEADER_AT = 1, 17  # the header record, and where its profile begins
_HEAD_BYTES = 4096  # read to find the profile


def mcap_profile(path: Path) -> str | None:
    """The profile that the header of an MCAP file names; None where it has no header. Reads its first bytes only."""
    try:
        with path.open("rb") as file:
            head = file.read(_HEAD_BYTES)
    except OSError:
        return None
    if not head.startswith(_MAGIC) or len(head) < _HEADER_AT + 4 or head[len(_MAGIC)] != _HEADER_OPCODE:
        return None
    size = int.from_bytes(head[_HEADER_AT : _HEADER_AT + 4], "little")
    profile = head[_HEADER_AT + 4 : _HEADER_AT + 4 + size]
    return profile.decode("utf-8", "replace") if len(profile) == size else None
