"""`[link]`: how the ground station is connected and whom it believes."""

from pathlib import Path
from typing import Annotated, Any, Literal

from pydantic import BaseModel, ConfigDict, Field, field_validator


class LinkConfig(BaseModel):
    """ports: as `daq.transport.ports.parse_port` reads them; listeners bind to loopback unless a host is named.

    systems: aircraft to listen to, all when empty. backfill: `lost` fetches scans lost on the link whenever there is
    bandwidth, `all` fetches every scan in full (at the end of a flight), `off` asks for nothing.
    """

    model_config = ConfigDict(extra="forbid", frozen=True, allow_inf_nan=False)

    ports: tuple[str, ...] = ("udpin:14550",)
    systems: tuple[Annotated[int, Field(ge=1, le=254)], ...] = ()
    system_id: Annotated[int, Field(ge=1, le=255)] = 255
    component_id: Annotated[int, Field(ge=1, le=255)] = 190
    key_file: Path | None = None  # 32 bytes or 64 hexadecimal digits, mode 0600; with it unsigned frames are refused
    signing_state: Path | None = None  # where signing timestamps survive a restart; default beside the key
    backfill: Literal["off", "lost", "all"] = "lost"
    transmit: bool = True  # False: listen only (no heartbeat, no time sync, no backfill)

    @field_validator("ports", mode="before")
    @classmethod
    def _one_port_is_a_list_too(cls, value: Any) -> Any:
        return (value,) if isinstance(value, str) else value

    @field_validator("ports")
    @classmethod
    def _each_port_once(cls, value: tuple[str, ...]) -> tuple[str, ...]:
        twice = [p for p in value if value.count(p) > 1]
        if twice:
            raise ValueError(f"port {twice[0]!r} is listed twice")
        return value
