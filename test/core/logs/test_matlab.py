# SPDX-FileCopyrightText: 2026 The quadpi authors
# SPDX-License-Identifier: Apache-2.0
"""MATLAB files as scipy writes them, and what is not read of them."""

import io
import struct

import numpy as np
import pytest
import scipy.io
import scipy.sparse

from quadpi_core.errors import LogError
from quadpi_core.logs.column_files import read_matlab


@pytest.fixture
def read(tmp_path):
    """read(content, …): the variables of a file of these bytes, or of these variables."""

    def variables(content, **options):
        path = tmp_path / "flight.mat"
        path.write_bytes(content if isinstance(content, bytes) else written(content, **options))
        return read_matlab(path)

    return variables


def written(variables, **options):
    file = io.BytesIO()
    scipy.io.savemat(file, variables, **options)
    return file.getvalue()


@pytest.mark.parametrize("packed", [False, True])
@pytest.mark.parametrize("kind", ["f8", "f4", "i1", "u2", "i8", "u8"])
def test_matrices_are_read_to_the_bit(read, kind, packed):
    matrix = np.arange(12).reshape(3, 4).astype(kind)
    (found,) = read({"m": matrix}, do_compression=packed)
    assert (found.name, found.kind) == ("m", "matrix")
    np.testing.assert_array_equal(found.values, matrix)
    assert found.values.dtype == matrix.dtype


def test_other_variables_are_named_and_not_read(read):
    variables = {
        "t": "abc",
        "s": scipy.sparse.eye(3),
        "c": np.eye(2) * 1j,
        "q": {"a": "b"},
        "l": np.array(["x", 1.0], dtype=object),
        "d": np.ones((2, 2, 2)),
    }
    found = {variable.name: variable.kind for variable in read(variables)}
    assert found == {
        "t": "text",
        "s": "sparse matrix",
        "c": "complex matrix",
        "q.a": "text",
        "l": "cell array",
        "d": "array of 3 dimensions",
    }
    assert all(variable.values is None for variable in read(variables))


def test_fields_of_structs_are_variables_with_a_dot(read):
    log = {"imu": {"t": np.arange(3.0), "gyro": np.ones((3, 3)), "none": np.empty((0, 0))}, "unit_of_t": "s"}
    found = {one.name: one for one in read({"log": log, "other": np.eye(2)})}
    assert {"log.imu.t", "log.imu.gyro", "log.imu.none", "log.unit_of_t", "other"} == set(found)
    np.testing.assert_array_equal(found["log.imu.gyro"].values, np.ones((3, 3)))
    assert found["log.unit_of_t"].values is None


def test_a_damaged_struct_is_one_error_or_other_numbers(read):
    """scipy crashes on some of them."""
    whole = written({"s": {"t": np.arange(4.0), "gyro": {"x": np.ones((4, 3))}}})
    refused = 0
    for place in range(136, len(whole), 16):
        data = bytearray(whole)
        data[place] ^= 0xFF
        try:
            read(bytes(data))
        except LogError:
            refused += 1
    assert refused > 0.2 * len(whole) / 16


def test_big_endian(read):
    head = b"MATLAB 5.0".ljust(124) + struct.pack(">H", 0x0100) + b"MI"
    body = struct.pack(">IIII", 6, 8, 6, 0) + struct.pack(">IIii", 5, 8, 1, 2)
    body += struct.pack(">II", 1, 1) + b"m".ljust(8, b"\0") + struct.pack(">IIdd", 9, 16, 1.5, -2.0)
    (found,) = read(head + struct.pack(">II", 14, len(body)) + body)
    np.testing.assert_array_equal(found.values, [[1.5, -2.0]])


@pytest.mark.parametrize(
    ("data", "message"),
    [
        (b"\x89HDF\r\n\x1a\n" + bytes(600), "MATLAB 7.3 file"),
        (bytes(50), "cannot be read"),
        (written({"m": np.eye(9)})[:-100], "cannot be read"),
        (written({"m": np.eye(9)}, do_compression=True)[:-1], "cannot be read"),
        (written({"m": np.eye(2)})[:140], "cannot be read"),
    ],
)
def test_what_is_damaged_or_another_version(read, data, message):
    with pytest.raises(LogError, match=message):
        read(data)
