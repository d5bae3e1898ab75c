# SPDX-FileCopyrightText: 2026 The quadpi authors
# SPDX-License-Identifier: Apache-2.0
"""Flights of paths, patterns and lists, their parts, and what is refused."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

import quadpi_core as qp
from quadpi_core.identification.prepared_flights import prepare_flights
from quadpi_core.paths import bags_directory

BAGS = bags_directory()


def test_they_are_those_of_the_commands(training):
    expected = prepare_flights([BAGS / f"train_{k}.mcap" for k in (1, 2, 3, 4)], qp.Vehicle.load("bebop2"))
    assert training.names == ("train_1", "train_2", "train_3", "train_4")
    for one, other in zip(training.prepared, expected, strict=True):
        assert np.array_equal(one.inputs, other.inputs)
        assert np.array_equal(one.wrench, other.wrench)
        assert one.sha256 == other.sha256


def test_any_path_pattern_or_list(training, monkeypatch):
    monkeypatch.chdir(BAGS.parent)
    vehicle = qp.Vehicle.load("bebop2")
    for logs in ("bags/train_1.mcap", BAGS / "train_1.mcap", ["bags/train_[1].mcap"], "b*/train_1*"):
        assert np.array_equal(qp.load_flights(logs, vehicle).inputs, training[0].inputs)
    both = qp.load_flights(["bags/interpolation.mcap", "bags/train_1.m*"], vehicle)
    assert both.names == ("interpolation", "train_1")


def test_parts_are_flights_too(training):
    assert [flight.names for flight in training] == [(name,) for name in training.names]
    assert training[1:3].names == ("train_2", "train_3")
    assert training[-1].names == training["train_4"].names == ("train_4",)
    assert training[np.array([True, False, False, True])].names == ("train_1", "train_4")
    assert training[[2, 0]].names == ("train_3", "train_1")
    assert (training[:1] + training[2:]).names == ("train_1", "train_3", "train_4")
    samples = len(training.time)
    assert training.inputs.shape == (samples, 19)
    assert training.wrench.shape == (samples, 6)
    assert training.labels.shape == training.speed.shape == (samples,)
    assert np.array_equal(training.wrench[training.labels == 1], training[1].wrench)


def test_what_cannot_be_used_is_left_out_where_it_is_asked_for(tmp_path):
    (tmp_path / "broken.mcap").write_bytes(b"nothing")
    logs, left_out = [tmp_path / "broken.mcap", BAGS / "train_1.mcap"], []
    with pytest.raises(qp.QuadpiError, match=r"broken\.mcap"):
        qp.load_flights(logs, "bebop2")
    assert qp.load_flights(logs, "bebop2", left_out=left_out).names == ("train_1",)
    assert [flight.flight for flight in left_out] == ["broken"]


@pytest.mark.parametrize(
    ("call", "message"),
    [
        (lambda _: qp.load_flights("no/*.mcap", "bebop2"), r"no/\*\.mcap: no file fits this pattern"),
        (lambda _: qp.load_flights("no.mcap", "bebop2"), r"no\.mcap: no such file"),
        (lambda _: qp.load_flights(7, "bebop2"), "logs: expected paths, found int 7"),
        (lambda _: qp.load_flights(BAGS / "train_1.mcap", "bebop3"), "bebop3"),
        (
            lambda f: qp.load_flights(BAGS / "train_1.mcap", f.vehicle, workers=0),
            "workers: expected a whole num",
        ),
        (
            lambda f: qp.load_flights("no.mcap", f.vehicle, left_out=()),
            "left_out: expected list, found tuple",
        ),
        (lambda f: qp.Flights(f.prepared, "bebop2"), "vehicle: expected Vehicle, found str 'bebop2'"),
        (lambda f: qp.Flights(f.prepared, f.vehicle, -1.0), "cutoff_hz: expected a positive number"),
        (lambda f: f + f, "flights: two are called train_1: load them in one call, which names them"),
        (
            lambda f: f[:1] + qp.Flights([replace(f.prepared[0], name="copy")], f.vehicle),
            "flights: train_1 and copy are the same flight: give it once",
        ),
        (lambda f: f[[]], "flights: expected one at least, found none"),
        (lambda f: f[:1] + replace(f[1:2], cutoff_hz=20.0), "low-passed at 30 and at 20 Hz: load them alike"),
        (
            lambda f: f[:1] + replace(f[1:2], vehicle=qp.Vehicle.load("neurobem")),
            "of two vehicles, bebop2",
        ),
        (lambda f: qp.Flights([f], f.vehicle), "prepared, entry 1: expected PreparedFlight"),
    ],
)
def test_a_plausible_mistake_is_one_clear_line(training, call, message):
    with pytest.raises(qp.QuadpiError, match=message) as caught:
        call(training)
    assert "\n" not in str(caught.value)


def test_a_name_that_is_none_of_them(training):
    with pytest.raises(KeyError, match="no flight train_9; there are train_1, train_2"):
        training["train_9"]


def test_they_show_themselves(training):
    assert repr(training) == (
        "<Flights: 4 flights of bebop2 (train_1, train_2, train_3, train_4), 76 s, 38004 samples, "
        "up to 6.2 m/s, low-pass 30 Hz>"
    )
    assert "<td>train_2</td><td>19.0</td><td>9501</td><td>500</td><td>5.6</td>" in training._repr_html_()
