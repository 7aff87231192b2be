"""MATLAB files of both kinds: written by scipy (5) and by h5py as MATLAB lays out 7.3, and by our own export."""

import struct
import zlib
from pathlib import Path
from typing import Any

import h5py
import numpy as np
import pytest
from scipy.io import savemat

from groundstation.export.run import export_file
from groundstation.flight import read_flight, write_flight
from groundstation.importers.errors import ImportDataError
from groundstation.importers.run import import_data

Columns = dict[str, np.ndarray]
DEG = 180 / np.pi


def save_v5(path: Path, variables: dict[str, Any]) -> Path:
    savemat(path, variables, do_compression=True, long_field_names=True, oned_as="column")
    return path


def save_v73(path: Path, variables: dict[str, Any]) -> Path:
    """As MATLAB writes it: transposed, structs as groups, arrays of structs and cells as references, a header of 512 bytes."""
    with h5py.File(path, "w", userblock_size=512) as file:
        for name, value in variables.items():
            _put(file, file.require_group("#refs#"), name, value)
    head = b"MATLAB 7.3 MAT-file".ljust(124) + struct.pack("<H", 0x0200) + b"IM"
    path.write_bytes(head.ljust(512, b"\0") + path.read_bytes()[512:])
    return path


def _put(group: h5py.Group, refs: h5py.Group, name: str, value: Any) -> None:
    if isinstance(value, dict):
        made: Any = group.create_group(name)
        made.attrs["MATLAB_class"] = np.bytes_("struct")
        for key, part in value.items():
            _put(made, refs, key, part)
    elif isinstance(value, list) and value and isinstance(value[0], dict):
        made = group.create_group(name)
        made.attrs["MATLAB_class"] = np.bytes_("struct")
        for key in value[0]:
            made.create_dataset(key, data=_references(refs, [item[key] for item in value]), dtype=h5py.ref_dtype)
    elif isinstance(value, str):
        made = group.create_dataset(name, data=np.frombuffer(value.encode("utf-16-le"), np.uint16).reshape(-1, 1))
        made.attrs["MATLAB_class"] = np.bytes_("char")
    else:
        made = group.create_dataset(name, data=np.atleast_2d(value), compression="gzip")
        made.attrs["MATLAB_class"] = np.bytes_("double")


def _references(refs: h5py.Group, values: list[Any]) -> np.ndarray:
    out = np.empty((len(values), 1), h5py.ref_dtype)
    for i, value in enumerate(values):
        name = f"r{len(refs)}"
        _put(refs, refs, name, value)
        out[i, 0] = refs[name].ref
    return out


SAVE = pytest.mark.parametrize("save", [save_v5, save_v73])


def as_columns(flown: Columns) -> dict[str, Any]:
    return {n: v.reshape(-1, 1) for n, v in flown.items()}


@SAVE
def test_a_struct_of_vectors_with_units_beside_them(tmp_path: Path, flown: Columns, save: Any) -> None:
    record = (
        as_columns({**flown, "phi": flown["phi"] * DEG}) if save is save_v5 else {**flown, "phi": flown["phi"] * DEG}
    )
    path = save(tmp_path / "log.mat", {"flight": {**record, "units": {"phi": "deg", "V": "m/s"}, "mass": 12.0}})
    flight = import_data(path)
    for name, values in flown.items():
        if name != "time":
            np.testing.assert_allclose(flight[name], values, rtol=1e-12, atol=1e-12, err_msg=name)
    np.testing.assert_allclose(flight.time, flown["time"])


@SAVE
def test_records_in_an_array_of_structs_become_segments(tmp_path: Path, flown: Columns, save: Any) -> None:
    def record(first: int, last: int) -> dict[str, np.ndarray]:
        shaped = {n: v[first:last] for n, v in flown.items()} | {"time": flown["time"][: last - first]}
        return as_columns(shaped) if save is save_v5 else shaped

    records = [record(0, 150), record(150, 400)]
    held: Any = np.array(records, dtype=object) if save is save_v5 else records
    flight = import_data(save(tmp_path / "log.mat", {"manoeuvre": held}))
    assert [part.stop - part.start for part in flight.segments] == [150, 250]
    np.testing.assert_allclose(flight["p"], flown["p"])
    assert np.all(np.diff(flight.time) > 0)
    assert any("2 records in a row" in n.text for n in flight.notes)
    assert any("begin before the end" in n.text for n in flight.notes)


@SAVE
def test_loose_variables_nested_structs_and_a_matrix(tmp_path: Path, flown: Columns, save: Any) -> None:
    attitude = np.column_stack([flown["phi"], flown["theta"]]) * DEG
    columns = as_columns(flown) if save is save_v5 else flown
    variables = {
        "t": columns["time"],
        "att": attitude if save is save_v5 else attitude.T,
        "air": {"tas": columns["V"]},
        "name": "second",
        "short": np.arange(5.0).reshape(1, -1),
    }
    path = save(tmp_path / "log.mat", variables)
    mapping = tmp_path / "map.toml"
    mapping.write_text(
        'format = 1\n[time]\ncolumn = "t"\n[columns]\nphi = { column = "att[0]", unit = "deg" }\n'
        'theta = { column = "att[1]", unit = "deg" }\nV = { column = "air.tas", unit = "m/s" }\n'
    )
    flight = import_data(path, mapping)
    np.testing.assert_allclose(flight["phi"], flown["phi"], atol=1e-12)
    np.testing.assert_allclose(flight["theta"], flown["theta"], atol=1e-12)
    np.testing.assert_allclose(flight["V"], flown["V"])
    assert any("short" in n.text and "left out" in n.text for n in flight.notes)


def test_what_export_writes_comes_back(tmp_path: Path, flown: Columns) -> None:
    write_flight(import_data(save_v5(tmp_path / "a.mat", as_columns(flown))), tmp_path / "a.mcap")
    export_file(tmp_path / "a.mcap", tmp_path / "b.mat")
    first, again = read_flight(tmp_path / "a.mcap"), import_data(tmp_path / "b.mat")
    for name in first.columns:
        np.testing.assert_array_equal(again[name], first[name])


def test_a_variable_is_chosen_by_name(tmp_path: Path, flown: Columns) -> None:
    path = save_v5(tmp_path / "log.mat", {"one": as_columns(flown), "two": as_columns({**flown, "V": flown["V"] + 1})})
    mapping = tmp_path / "map.toml"
    mapping.write_text('format = 1\n[file]\nvariable = "two"\n')
    np.testing.assert_allclose(import_data(path, mapping)["V"], flown["V"] + 1)
    mapping.write_text('format = 1\n[file]\nvariable = "three"\n')
    with pytest.raises(ImportDataError, match="no variable 'three'; found one, two"):
        import_data(path, mapping)


def element(kind: int, data: bytes) -> bytes:
    return struct.pack("<II", kind, len(data)) + data + bytes(-len(data) % 8)


def v5_with(matrix: bytes) -> bytes:
    return b"MATLAB 5.0 MAT-file".ljust(124) + struct.pack("<H", 0x0100) + b"IM" + matrix


def array_of(dims: tuple[int, ...], data: bytes, kind: int = 9, made: int = 6) -> bytes:
    parts = (
        element(6, struct.pack("<II", made, 0)) + element(5, struct.pack(f"<{len(dims)}i", *dims)) + element(1, b"x")
    )
    return element(14, parts + element(kind, data))


@pytest.mark.parametrize(
    "content",
    [
        array_of((2**30, 2**30), bytes(64)),
        array_of((2**27, 1), bytes(64), made=1),
        array_of((2**27, 1), bytes(64), made=2),
        element(15, zlib.compress(bytes(200_000_000), 9)),
        b"\x0e\0\0\0\xff\xff\xff\x7f" + bytes(100),
        b"",
    ],
    ids=["dims", "cells", "structs", "bomb", "cut", "empty"],
)
def test_a_file_that_announces_too_much_is_a_sentence(tmp_path: Path, content: bytes) -> None:
    path = tmp_path / "x.mat"
    path.write_bytes(v5_with(content))
    with pytest.raises(ImportDataError, match="no vectors of numbers over time"):
        import_data(path)


def test_older_and_spoilt_files_are_sentences(tmp_path: Path, flown: Columns) -> None:
    path = tmp_path / "x.mat"
    savemat(path, {"t": flown["time"]}, format="4")
    with pytest.raises(ImportDataError, match="save it with -v7"):
        import_data(path)
    save_v73(path, flown)
    path.write_bytes(path.read_bytes()[:2000])
    with pytest.raises(ImportDataError, match=r"damaged MATLAB 7\.3"):
        import_data(path)


def test_a_constant_that_unpacks_to_too_much_in_hdf5_is_a_sentence(tmp_path: Path) -> None:
    path = tmp_path / "x.mat"
    with h5py.File(path, "w", userblock_size=512) as file:
        file.create_dataset("x", shape=(1, 2**33), dtype="f8", chunks=(1, 2**16), compression="gzip")
    with pytest.raises(ImportDataError, match="larger than"):
        import_data(path)


def test_a_file_at_which_the_compiled_reader_crashes_is_a_sentence(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    (tmp_path / "x.mat").write_bytes(v5_with(array_of((-4, 2), bytes(64))))
    with pytest.raises(ImportDataError, match=r"no (vectors|column)"):
        import_data(tmp_path / "x.mat")
    (tmp_path / "child.py").write_text("import os; os.abort()")
    monkeypatch.setattr("groundstation.importers.formats.matlab._CHILD", tmp_path / "child.py")
    with pytest.raises(ImportDataError, match="damaged MATLAB 5 file, at which its reader crashes"):
        import_data(tmp_path / "x.mat")
