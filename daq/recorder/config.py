"""`[recorder]`: where recordings go and how they are protected."""

from pathlib import Path
from typing import Annotated

from pydantic import BaseModel, ConfigDict, Field


class RecorderConfig(BaseModel):
    """Limits of the recorder. The defaults lose at most the last second and ride out a stall of a minute."""

    model_config = ConfigDict(extra="forbid", frozen=True, allow_inf_nan=False)

    directories: Annotated[tuple[Path, ...], Field(min_length=1)] = (Path("recordings"),)  # tried in order
    flush_s: Annotated[float, Field(gt=0, le=60)] = 0.5  # a chunk is closed, checksummed and handed to the system
    sync: bool = True  # fdatasync, in a thread of its own
    sync_s: Annotated[float, Field(gt=0, le=600)] = 1.0  # this often
    compress: bool = False  # zstd halves the file, but a bad bit then costs the whole chunk instead of one scan
    queue_s: Annotated[float, Field(gt=0, le=3600)] = 60.0  # scans held in memory while the card stalls
    segment_s: Annotated[float, Field(gt=0)] = 120.0  # a new file this often: bounds what one bad sector can cost
    statistics_s: Annotated[float, Field(gt=0)] = 10.0  # accounting and timing written this often
    remove_oldest: bool = False  # may the oldest recordings be removed when the card is full?
    keep_free_mb: Annotated[float, Field(ge=0)] = 20.0  # with remove_oldest: make room below this
    retry_s: Annotated[float, Field(gt=0)] = 0.5  # pause between attempts to open a new file after an error
