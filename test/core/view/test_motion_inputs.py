# SPDX-FileCopyrightText: 2026 The quadpi authors
# SPDX-License-Identifier: Apache-2.0
"""Inputs from topics are those that the monitor sees, but for its low-pass."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from quadpi_core.flight import OdometryStream, RotorSpeedStream, WindStream
from quadpi_core.logs.bag_files import Bag
from quadpi_core.logs.bags import read_bag
from quadpi_core.messages.sensor_messages import unpack_odometry
from quadpi_core.view.trust import STRETCH_NS, MotionInputs

from .conftest import BAG


@pytest.fixture(scope="module")
def published(results_bag, vehicle) -> tuple[OdometryStream, RotorSpeedStream]:
    """What the estimator publishes for the flight, and its rotor speeds."""
    with Bag(results_bag) as bag:
        states = unpack_odometry(bag.read(["/odometry"])["/odometry"].payloads)
    rotors = read_bag(BAG, vehicle).rotor_speeds
    assert rotors is not None
    return states, rotors


def test_they_are_those_of_the_monitor(published, model, vehicle, judged_view):
    time_ns, inputs = MotionInputs(vehicle).take(*published, None)
    assert np.all(np.diff(time_ns)[:-1] == STRETCH_NS)
    blocks = (time_ns - judged_view.start_ns) // judged_view.blocks.block_ns
    chosen = (blocks >= 40) & (blocks < judged_view.blocks.newest)
    judged = np.array([judged_view.blocks.value(int(block), "inputs") for block in blocks[chosen]])
    apart = np.abs(inputs[chosen] - judged) / model.envelope.scale
    assert np.median(apart) < 0.02
    assert np.quantile(apart, 0.99) < 0.3


def test_states_without_rotor_speeds_near_them_have_none(published, vehicle):
    states, rotors = published
    live = MotionInputs(vehicle)
    assert len(live.take(states, None, None)[0]) == 0
    early = rotors.time_ns <= states.time_ns[20]
    time_ns, _ = live.take(states, RotorSpeedStream(rotors.time_ns[early], rotors.speeds[early]), None)
    assert 0 < len(time_ns) < 10
    # The last rotor speeds of before are those of the first states of now.
    assert len(live.take(states.take(np.arange(20)), None, None)[0]) > 0


def test_wind_is_taken_off(published, vehicle):
    live = MotionInputs(vehicle)
    _, still = live.take(*published, None)
    north = WindStream(published[0].time_ns[:1], np.array([[1.0, 0.0, 0.0]]))
    _, windy = live.take(*published, north)
    assert np.abs(windy[:, :3] - still[:, :3]).max() == pytest.approx(1.0, abs=0.1)


def test_other_numbers_of_rotors_are_said(published, vehicle):
    states, rotors = published
    live = MotionInputs(vehicle)
    assert len(live.take(states, replace(rotors, speeds=np.zeros((len(rotors.time_ns), 6))), None)[0]) == 0
    assert live.problem.startswith("topic rotor_speeds: 6 rotors, vehicle bebop2 has 4")
