"""Footers of Parquet files as our own reader sees them, beside what Arrow says of them."""

import io

import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq
import pytest
from hypothesis import given
from hypothesis import strategies as st

from groundstation.flight.files.parquet_columns import ThriftReader


def _file() -> bytes:
    table = pa.table({"time": np.arange(40) / 20, "word": ["a", None] * 20, "p": pa.array([1.0, None] * 20)})
    stream = io.BytesIO()
    pq.write_table(table, stream, row_group_size=16)
    return stream.getvalue()


def test_places_of_the_pages_are_those_that_arrow_reads() -> None:
    data = _file()
    footer = ThriftReader(data, len(data) - 8 - int.from_bytes(data[-8:-4], "little")).struct()
    metadata = pq.ParquetFile(io.BytesIO(data)).metadata
    assert footer[3] == metadata.num_rows == 40
    assert len(footer[4]) == metadata.num_row_groups == 3
    for group, fields in enumerate(footer[4]):
        for column, chunk in enumerate(fields[1]):
            meta, said = chunk[3], metadata.row_group(group).column(column)
            assert b".".join(meta[3]).decode() == said.path_in_schema
            assert (meta[5], meta[7], meta[9]) == (
                said.num_values,
                said.total_compressed_size,
                said.data_page_offset,
            )
            assert meta.get(11) == said.dictionary_page_offset


@given(st.binary(max_size=200))
def test_any_bytes_are_a_struct_or_a_value_error(data: bytes) -> None:
    reader = ThriftReader(data, most=50)
    try:
        reader.struct()
    except ValueError:
        return
    assert reader.end <= len(data)


@pytest.mark.parametrize(
    "data", [b"\x11" * 99, b"\x14" * 99, b"\x19\xfc" + b"\x63" + bytes(99)], ids=["fields", "numbers", "list"]
)
def test_values_are_counted(data: bytes) -> None:
    with pytest.raises(ValueError, match="too many values"):
        ThriftReader(data, most=40).struct()
