# SPDX-FileCopyrightText: 2026 The quadpi authors
# SPDX-License-Identifier: Apache-2.0
"""Inputs from topics are those that the monitor sees."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from quadpi_core.errors import LogError
from quadpi_core.flight import OdometryStream, RotorSpeedStream
from quadpi_core.logs.bag_files import Bag
from quadpi_core.logs.bags import read_bag
from quadpi_core.messages.sensor_messages import unpack_odometry
from quadpi_core.view.live_inputs import LiveInputs

from .conftest import BAG


@pytest.fixture(scope="module")
def published(results_bag, vehicle) -> tuple[OdometryStream, RotorSpeedStream]:
    """What the estimator publishes for the flight, and its rotor speeds."""
    with Bag(results_bag) as bag:
        states = unpack_odometry(bag.read(["/odometry"])["/odometry"].payloads)
    rotors = read_bag(BAG, vehicle).rotor_speeds
    assert rotors is not None
    return states, rotors


def batches(published, length: int):
    """As they arrive: states of a time with the rotor speeds of that time."""
    states, rotors = published
    for first in range(0, len(states), length):
        rows = slice(first, first + length)
        until = states.time_ns[rows][-1] + 2_500_000
        since = states.time_ns[first] if first else 0
        chosen = (rotors.time_ns >= since) & (rotors.time_ns < until)
        part = OdometryStream(*(values[rows] for values in vars(states).values()))
        yield part, RotorSpeedStream(rotors.time_ns[chosen], rotors.speeds[chosen])


def test_they_are_those_of_the_monitor(published, model, vehicle, judged_view):
    live = LiveInputs(vehicle, model.cutoff_hz)
    low = np.full((500, 19), np.inf)
    high = np.full((500, 19), -np.inf)
    for states, rotors in batches(published, 20):
        time_ns, inputs = live.take(states, rotors)
        numbers = (time_ns - judged_view.start_ns) // judged_view.blocks.block_ns
        np.minimum.at(low, numbers[numbers >= 0], inputs[numbers >= 0])
        np.maximum.at(high, numbers[numbers >= 0], inputs[numbers >= 0])
    scale = model.envelope.scale
    for block in range(40, judged_view.blocks.newest - 1):
        for name, found in (("inputs_min", low), ("inputs_max", high)):
            judged = judged_view.blocks.value(block, name)
            np.testing.assert_allclose(
                found[block] / scale, judged / scale, atol=0.01, err_msg=f"{name} {block}"
            )


def test_batches_do_not_matter(published, model, vehicle):
    whole, parts = (LiveInputs(vehicle, model.cutoff_hz).take for _ in range(2))
    states, rotors = published
    short = OdometryStream(*(values[:900] for values in vars(states).values()))
    few = RotorSpeedStream(rotors.time_ns[:1000], rotors.speeds[:1000])
    time_ns, inputs = whole(short, few)
    found = [parts(part, some) for part, some in batches((short, few), 31)]
    np.testing.assert_array_equal(np.concatenate([one for one, _ in found]), time_ns)
    np.testing.assert_allclose(np.concatenate([one for _, one in found]), inputs, rtol=1e-9, atol=1e-9)


def test_it_starts_again_behind_a_gap_and_a_jump(published, model, vehicle):
    live = LiveInputs(vehicle, model.cutoff_hz)
    states, rotors = published
    first = OdometryStream(*(values[:500] for values in vars(states).values()))
    live.take(first, rotors)
    earlier = replace(first, time_ns=first.time_ns - 5_000_000_000)
    before = RotorSpeedStream(rotors.time_ns - 5_000_000_000, rotors.speeds)
    time_ns, inputs = live.take(earlier, before)
    assert len(time_ns) > 0
    assert np.isfinite(inputs).all()


def test_a_block_of_a_bag_is_taken_whole_and_both_sides_of_a_gap(published, model, vehicle):
    states, rotors = published
    assert len(states) > 5000
    gone = (states.time_ns < states.time_ns[2000]) | (states.time_ns > states.time_ns[2500])
    time_ns, inputs = LiveInputs(vehicle, model.cutoff_hz).take(states.take(gone), rotors)
    ready = states.time_ns[gone & (states.time_ns <= rotors.time_ns[-1])]
    np.testing.assert_array_equal(time_ns, ready)
    whole_ns, whole = LiveInputs(vehicle, model.cutoff_hz).take(states, rotors)
    # A second behind the gap the low-pass has forgotten it.
    behind_ns = states.time_ns[2500] + 1_000_000_000
    np.testing.assert_allclose(inputs[time_ns > behind_ns], whole[whole_ns > behind_ns], rtol=1e-3, atol=1e-3)


def test_another_number_of_rotors_is_refused_by_name(published, model, vehicle):
    states, rotors = published
    six = RotorSpeedStream(rotors.time_ns, np.tile(rotors.speeds[:, :1], (1, 6)))
    with pytest.raises(LogError, match="topic rotor_speeds: 6 rotors, vehicle bebop2 has 4"):
        LiveInputs(vehicle, model.cutoff_hz).take(states, six)


def test_nothing_comes_without_rotor_speeds_or_a_rate_that_fits(published, model, vehicle):
    states, rotors = published
    assert len(LiveInputs(vehicle, model.cutoff_hz).take(states, None)[0]) == 0
    slow = OdometryStream(*(values[::100] for values in vars(states).values()))
    assert len(LiveInputs(vehicle, model.cutoff_hz).take(slow, rotors)[0]) == 0
