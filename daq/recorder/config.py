"""`[recorder]`: where recordings go and how they are protected."""

from pathlib import Path
from typing import Annotated

from pydantic import BaseModel, ConfigDict, Field


class RecorderConfig(BaseModel):
    """`[recorder]`. With the defaults a power cut costs at most the last second, and a stall of the card of a minute nothing."""

    model_config = ConfigDict(extra="forbid", frozen=True, allow_inf_nan=False)

    directories: Annotated[tuple[Path, ...], Field(min_length=1)] = (Path("recordings"),)  # tried in order
    flush_s: Annotated[float, Field(gt=0, le=60)] = 0.5  # period of chunks, each with a checksum
    sync: bool = True  # fdatasync, in a thread of its own
    # Period of syncs. A power cut costs this, `scan.hand_over_s` and the time of one sync: with 0.5 s less than a second on a
    # card that takes 0.2 s for each. A shorter one writes more and wears the card (measured in docs/logger.md).
    sync_s: Annotated[float, Field(gt=0, le=600)] = 0.5
    compress: bool = False  # zstd halves the file, but a bad bit then costs the whole chunk instead of one scan
    queue_s: Annotated[float, Field(gt=0, le=3600)] = 60.0  # scans held in memory while the card stalls
    segment_s: Annotated[float, Field(gt=0)] = 120.0  # length of a file, which bounds what one bad sector can cost
    statistics_s: Annotated[float, Field(gt=0)] = 10.0  # period of statistics in the recording
    remove_oldest: bool = False  # whether the oldest recordings are removed when the card is full
    keep_free_mb: Annotated[float, Field(ge=0)] = 20.0  # with remove_oldest: least free space
    retry_s: Annotated[float, Field(gt=0)] = 0.5  # pause before a new file after an error; doubled up to 8 s
