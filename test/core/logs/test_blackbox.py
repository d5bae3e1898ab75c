# SPDX-FileCopyrightText: 2026 The quadpi authors
# SPDX-License-Identifier: Apache-2.0
"""Blackbox logs: every predictor and kind of frame, damage and its limits, a real log value by value."""

from __future__ import annotations

import hashlib
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from quadpi_core.core import compiled
from quadpi_core.errors import LogError
from quadpi_core.logs.formats.betaflight import RULES, decode_blackbox

from .blackbox_writer import PLAIN, inter, intra, log, signed, unsigned


def read(data, *names):
    found = decode_blackbox(data, names)
    assert found.damaged_at is None
    return [found.columns[name].tolist() for name in names]


def test_times_and_iterations_of_frames_that_carry_neither():
    data = log(
        PLAIN, [intra(0, 1000), inter(500), inter(-3), inter(3)], more=["I interval:32", "P interval:8"]
    )
    found = decode_blackbox(data, ["loopIteration"])
    assert found.columns["loopIteration"].tolist() == [0.0, 8.0, 16.0, 24.0]
    assert found.columns["time"].tolist() == [1000.0, 1500.0, 1997.0, 2497.0]
    assert found.ended
    assert found.headers["I interval"] == 32


@pytest.mark.parametrize(
    ("share", "logged"),
    # The table of the documentation.
    [
        ("1/6", "I.....P.....P.....P.....P.....P.I"),
        ("2/3", "I.PP.PP.PP.PP.PP.PP.PP.PP.PP.PP.I"),
        ("5/6", "I.PPPPP.PPPPP.PPPPP.PPPPP.PPPPP.I"),
        ("1/1", "IPPPPPPPPPPPPPPPPPPPPPPPPPPPPPPPI"),
    ],
)
def test_which_iterations_are_logged(share, logged):
    expected = [k for k, kind in enumerate(logged) if kind != "."]
    frames = [intra(0, 0), *(inter(k == 0) for k in range(len(expected) - 2)), intra(32, 99)]
    (found,) = read(
        log(PLAIN, frames, more=["I interval:32", f"P interval:{share}"]),
        "loopIteration",
    )
    assert found == expected


def test_numbers_without_sign_of_14_bits_and_none_at_all():
    fields = PLAIN | {"battery": (9, 3, 1, 3), "fixed": (8, 9, 0, 9), "big": (0, 1, 0, 1)}
    rest = unsigned(40) + unsigned(2**31 - 1)
    rises = unsigned(-5 & 0x3FFF) + unsigned(7)
    data = log(fields, [intra(0, 1, rest), inter(1, rises)], more=["vbatref:2466"])
    assert read(data, "battery", "fixed", "big") == [[2426, 2431], [1500, 0], [2**31 - 1, 7]]


def test_predictors():
    fields = PLAIN | {
        "last": (0, 0, 1, 0),
        "line": (0, 0, 2, 0),
        "mean": (0, 0, 3, 0),
        "motor[0]": (11, 0, 3, 0),
        "motor[1]": (5, 0, 3, 0),
        "old": (4, 0, 0, 0),
    }

    def rest(*values):
        return b"".join(map(signed, values))

    frames = [
        intra(0, 1, rest(10, 20, 3, 1, 2, 5)),
        inter(1, rest(1, 4, -7, 0, 0, 0)),
        inter(0, rest(1, 4, 0, 1, 2, 0)),
        inter(0, rest(0, 0, 0, 0, 0, 0)),
    ]
    data = log(fields, frames, more=["minthrottle:1070", "motorOutput:158,2047"])
    last, line, mean, first, second, old = read(data, *list(fields)[2:])
    assert last == [10, 11, 12, 12]
    assert line == [20, 24, 32, 40]
    # (3 − 4) / 2 is 0, as the firmware divides.
    assert mean == [3, -4, 0, -2]
    assert (first, second) == ([159, 159, 160, 159], [161, 161, 163, 162])
    assert old == [1075, 0, 0, 0]


def test_frames_that_are_not_of_the_main_loop_are_stepped_over():
    more = ["Field S name:mode,state", "Field S signed:0,0", "Field S predictor:0,0", "Field S encoding:1,1"]
    more += ["Field H name:a,b", "Field H encoding:0,0", "Field G name:time,n", "Field G encoding:1,1"]
    events = [
        b"E\x00\x05",
        b"E\x0d\x03\x09",
        b"E\x0d\x83abcd",
        b"E\x0e\x05\x06",
        b"E\x0f\x04",
        b"E\x1e\x01\x00",
    ]
    others = [b"S\x01\x02", b"H\x01\x02", b"G\x49\x50", *events]
    frames = [
        intra(0, 100),
        *(part for other in others for part in (other, inter(10 * (other == others[0])))),
    ]
    (times,) = read(log(PLAIN, frames, more=more), "time")
    assert times == [100.0 + 10 * k for k in range(len(others) + 1)]


def test_time_goes_on_where_its_bits_end():
    (times,) = read(log(PLAIN, [intra(0, 2**32 - 10), inter(7), inter(), intra(32, 11)]), "time")
    assert np.diff(times).tolist() == [7.0, 7.0, 7.0]


@pytest.mark.parametrize("end", [b"", b"E", b"E\xffEnd o", b"P", b"I\x80"])
def test_a_log_without_its_end_is_read_to_the_last_whole_frame(end):
    found = decode_blackbox(log(PLAIN, [intra(0, 5), inter(3)], end=end), [])
    assert found.columns["time"].tolist() == [5.0, 8.0]
    assert not found.ended


def test_what_rests_on_damage_is_left_out():
    whole = [intra(0, 1000), inter(10), inter(), inter(), intra(32, 1040), inter(10)]
    start = len(log(PLAIN, [], end=b""))
    damaged = log(PLAIN, [*whole[:2], b"P\xff\xff\xff\xff\xff\xff", *whole[3:]])
    found = decode_blackbox(damaged, [])
    assert found.columns["time"].tolist() == [1000.0, 1010.0, 1040.0, 1050.0]
    assert found.damaged_at == start + len(whole[0] + whole[1])
    assert found.damaged_bytes > 0
    assert found.ended


def test_one_wrong_time_does_not_cost_the_rest():
    leap = 40_000_000
    frames = [intra(0, 1000), intra(32, 1500 + leap), *(intra(32 * k, 1000 + 500 * k) for k in range(2, 6))]
    assert decode_blackbox(log(PLAIN, frames), []).columns["time"].tolist() == [
        *(1000.0, 2000.0, 2500.0),
        *(3000.0, 3500.0),
    ]
    # A logger that was paused goes on at a later time; only the first frame after it is missing.
    frames = [intra(0, 1000), *(intra(32 * k, leap + 500 * k) for k in range(1, 5))]
    assert np.diff(decode_blackbox(log(PLAIN, frames), []).columns["time"]).tolist() == [leap, 500.0, 500.0]


@pytest.mark.parametrize(
    ("old", "new", "message"),
    [
        (
            b"Field I name:loopIteration,time",
            b"Field I name:loopIteration,when",
            "name the field time 0 times",
        ),
        (b"Field I name:loopIteration,time", b"Field I name:time,time", "name the field time 2 times"),
        (b"Field P encoding:9,0", b"Field P encoding:9", "`Field P encoding` has 1 entries for 2 fields"),
        (b"Field P encoding:9,0", b"Field P encoding:9,4", "has an entry that is not known: 4"),
        (b"Field I predictor:0,0", b"Field I predictor:0,x", "has an entry that is not known: None"),
        (b"H Field P predictor:6,2\n", b"", "`Field P predictor` has 1 entries for 2 fields"),
    ],
)
def test_headers_that_do_not_describe_the_frames(old, new, message):
    data = log(PLAIN, [intra(0, 5)])
    assert old in data
    with pytest.raises(LogError, match=message):
        decode_blackbox(data.replace(old, new), [])


def test_intervals_that_no_firmware_writes():
    for more in (
        ["I interval:0", "P interval:0/0"],
        ["I interval:-5", "P interval:4000000000/7"],
        ["I interval:"],
    ):
        found = decode_blackbox(log(PLAIN, [intra(0, 5), inter(2), inter()], more=more), [])
        assert found.columns["time"].tolist() == [5.0, 7.0, 9.0]


@pytest.mark.parametrize(("fields", "accepted"), [(256, True), (257, False)])
def test_256_fields_are_the_most(fields, accepted):
    names = {f"f{k}": (0, 9, 0, 9) for k in range(fields - 2)}
    data = log(PLAIN | names, [intra(0, 5)])
    if accepted:
        assert read(data, "f253") == [[0.0]]
        return
    with pytest.raises(LogError, match="its header `Field I encoding` has 257 entries for 257 fields"):
        decode_blackbox(data, [])


@pytest.mark.parametrize(("length", "whole"), [(8191, True), (8192, False)])
def test_a_header_line_ends_within_8_kb(length, whole):
    """What begins as a header is a frame or damage where its line does not end."""
    line = "debug:" + "x" * (length - len("H debug:"))
    found = decode_blackbox(log(PLAIN, [intra(0, 5)], more=[line]), [])
    assert (found.damaged_bytes == 0) is whole


@pytest.mark.parametrize(("step_us", "whole"), [(10_000_000, True), (10_000_001, False)])
def test_a_frame_may_come_ten_seconds_after_the_one_before(step_us, whole):
    frames = [intra(0, 1000), intra(32, 1000 + step_us), intra(64, 1500)]
    found = decode_blackbox(log(PLAIN, frames), [])
    assert found.columns["time"].tolist() == [1000.0, *([1000.0 + step_us] if whole else [1500.0])]


@pytest.mark.parametrize(("share", "whole"), [(0.40, True), (0.47, False)])
def test_a_flight_is_read_again_up_to_sixteen_fields_for_each_byte(share, whole):
    """Damage costs the 202 fields of a frame at the first byte of each piece, and one at each other byte."""
    fields = PLAIN | {f"f{k}": (0, 0, 1, 0) for k in range(200)}
    frames = [intra(32 * k, 500 * k, 200 * signed(0)) for k in range(200)]
    piece = b"I" + b"\xff" * 5
    header = len(log(fields, [], end=b""))
    good = header + sum(map(len, frames))
    damage = piece * round(share / (1.0 - share) * good / len(piece))
    data = log(fields, [*frames[:100], damage, *frames[100:]])
    expected = 207 * len(damage) / len(piece)
    assert (expected < 16 * len(data)) is whole
    found = decode_blackbox(data, [])
    assert (len(found.columns["time"]) == 200) is whole
    assert found.damaged_at is not None


def test_frames_of_one_byte_cannot_fill_the_memory(monkeypatch):
    fields = dict.fromkeys(("loopIteration", "time", *(f"f{k}" for k in range(30))), (0, 9, 0, 9))
    monkeypatch.setenv("QUADPI_UNPACKED_MIB", "1")
    data = log(fields, [b"I" * 100_000])
    with pytest.raises(LogError, match="unpacks to more than the limit of 9 MiB"):
        decode_blackbox(data, list(fields))


@pytest.mark.parametrize(
    "piece", [b"I", b"IP", b"P\x80", b"I\xff\xff\xff\xff\xff", b"E\xffEnd of lo", b"S\x80"]
)
def test_long_damage_ends(piece):
    fields = PLAIN | {f"f{k}": (0, 0, 1, 7 if k % 3 else 6) for k in range(200)}
    data = log(fields, [piece * (2_000_000 // len(piece))], more=["Field S name:a", "Field S encoding:1"])
    found = decode_blackbox(data, [])
    assert found.damaged_bytes <= len(data)


@settings(max_examples=300, deadline=None)
@given(data=st.data())
def test_any_bytes_are_read_or_refused(data):
    fields = PLAIN | {f"f{k}": (0, (7, 8, 10)[k % 3], 1, 6) for k in range(9)}
    flight = bytearray(
        log(fields, [intra(32 * k, 500 * k, 9 * signed(k)) + inter(1, b"\x00\x00") for k in range(9)])
    )
    for place in data.draw(st.lists(st.integers(70, len(flight) - 1), max_size=12)):
        flight[place] = data.draw(st.integers(0, 255))
    cut = bytes(flight[: data.draw(st.integers(70, len(flight)))])
    try:
        found = decode_blackbox(cut, list(fields))
    except LogError:
        return
    assert all(np.isfinite(column).all() for column in found.columns.values())


# Of what orangebox 0.4.0 reads of the log, all 4280 frames of 171 fields as 64-bit integers.
KNOWN = "d83915113eef576c2bbb8448fd7b82763e3b67f1e496314a73f80d39c808699d"


def test_a_real_log_value_by_value(shared_data: Path):
    path = shared_data / "indiflight" / "LOG00258.BFL"
    if not path.is_file():
        pytest.skip(f"no {path}")
    flight = path.read_bytes()
    start = flight.index(b"Field I name:") + len(b"Field I name:")
    names = flight[start : flight.index(b"\n", start)].decode().split(",")
    found = decode_blackbox(flight, names)
    assert (found.ended, found.damaged_at) == (True, None)
    table = np.stack([found.columns[name] for name in names], axis=1).astype(np.int64)
    assert hashlib.sha256(table.tobytes()).hexdigest() == KNOWN


@pytest.mark.parametrize(
    ("name", "number"),
    [("sizes", 257), ("sizes", -1), ("time", 256), ("iteration", -1), ("motor", 256)]
    + [(name, 0) for name in ("every", "numerator", "denominator")],
)
def test_rules_that_point_outside_a_frame_are_refused(name, number):
    rules, table = np.zeros(1, RULES), np.empty(0)
    rules["every"] = rules["numerator"] = rules["denominator"] = 1
    assert compiled.decode_blackbox(b"", 0, rules, np.array([0, 255]), table) == (0, False, 0, 0)
    for field in (-1, 256):
        with pytest.raises(ValueError, match="a field that no frame has"):
            compiled.decode_blackbox(b"", 0, rules, np.array([0, field]), table)
    rules[name] = number
    with pytest.raises(ValueError, match="rules that are none"):
        compiled.decode_blackbox(b"", 0, rules, np.array([0]), table)
