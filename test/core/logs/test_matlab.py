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
from quadpi_core.logs.matlab import read_matlab


def written(variables, **options):
    file = io.BytesIO()
    scipy.io.savemat(file, variables, **options)
    return file.getvalue()


@pytest.mark.parametrize("packed", [False, True])
@pytest.mark.parametrize("kind", ["f8", "f4", "i1", "u2", "i8", "u8"])
def test_matrices_are_read_to_the_bit(kind, packed):
    matrix = np.arange(12).reshape(3, 4).astype(kind)
    (found,) = read_matlab(written({"m": matrix}, do_compression=packed))
    assert (found.name, found.kind) == ("m", "matrix")
    np.testing.assert_array_equal(found.values, matrix)
    assert found.values.dtype == matrix.dtype


def test_other_variables_are_named_and_not_read():
    variables = {
        "t": "abc",
        "s": scipy.sparse.eye(3),
        "c": np.eye(2) * 1j,
        "q": {"a": "b"},
        "l": np.array(["x", 1.0], dtype=object),
        "d": np.ones((2, 2, 2)),
    }
    found = {variable.name: variable.kind for variable in read_matlab(written(variables))}
    assert found == {
        "t": "text",
        "s": "sparse matrix",
        "c": "complex matrix",
        "q.a": "text",
        "l": "cell array",
        "d": "array of 3 dimensions",
    }
    assert all(variable.values is None for variable in read_matlab(written(variables)))


def test_fields_of_structs_are_variables_with_a_dot():
    log = {"imu": {"t": np.arange(3.0), "gyro": np.ones((3, 3)), "none": np.empty((0, 0))}, "unit_of_t": "s"}
    found = {one.name: one for one in read_matlab(written({"log": log, "other": np.eye(2)}))}
    assert {"log.imu.t", "log.imu.gyro", "log.imu.none", "log.unit_of_t", "other"} == set(found)
    np.testing.assert_array_equal(found["log.imu.gyro"].values, np.ones((3, 3)))
    assert found["log.unit_of_t"].values is None


def test_structs_within_structs_have_an_end():
    deep = {"v": 1.0}
    for _ in range(30):
        deep = {"s": deep}
    (found,) = read_matlab(written(deep))
    assert (found.name, found.kind) == (".".join(["s"] * 9), "struct")


def test_a_damaged_struct_is_one_error_or_other_numbers():
    whole = written({"s": {"t": np.arange(4.0), "gyro": {"x": np.ones((4, 3))}}})
    refused = 0
    for place in range(136, len(whole)):
        data = bytearray(whole)
        data[place] ^= 0xFF
        try:
            read_matlab(bytes(data))
        except LogError:
            refused += 1
    assert refused > 0.2 * len(whole)


def test_whole_numbers_of_a_matrix_of_doubles_take_fewer_bytes():
    """As MATLAB stores them: doubles, one byte each."""
    data = written({"m": np.ones((1, 8))})
    at = data.index(struct.pack("<II", 9, 64))
    smaller = bytearray(data[:at] + struct.pack("<II", 2, 8) + bytes(range(8)))
    size = struct.unpack_from("<I", smaller, 132)[0]
    struct.pack_into("<I", smaller, 132, size - 56)
    (found,) = read_matlab(bytes(smaller))
    assert found.values.dtype == np.float64
    np.testing.assert_array_equal(found.values, [np.arange(8.0)])


def test_big_endian():
    head = b"MATLAB 5.0".ljust(124) + struct.pack(">H", 0x0100) + b"MI"
    body = struct.pack(">IIII", 6, 8, 6, 0) + struct.pack(">IIii", 5, 8, 1, 2)
    body += struct.pack(">II", 1, 1) + b"m".ljust(8, b"\0") + struct.pack(">IIdd", 9, 16, 1.5, -2.0)
    (found,) = read_matlab(head + struct.pack(">II", 14, len(body)) + body)
    np.testing.assert_array_equal(found.values, [[1.5, -2.0]])


@pytest.mark.parametrize(
    ("data", "message"),
    [
        (b"\x89HDF\r\n\x1a\n" + bytes(600), "MATLAB 7.3 file"),
        (written({"m": np.eye(2)}, format="4"), "its header is of another version"),
        (bytes(50), "its header is of another version"),
        (written({"m": np.eye(9)})[:-100], "an element runs beyond its section"),
        (written({"m": np.eye(9)}, do_compression=True)[:-1], "an element runs beyond its section"),
        (written({"m": np.eye(2)})[:140], "an element runs beyond its section"),
    ],
)
def test_what_is_damaged_or_another_version(data, message):
    with pytest.raises(LogError, match=message):
        read_matlab(data)
