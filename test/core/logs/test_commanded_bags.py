# SPDX-FileCopyrightText: 2026 The quadpi authors
# SPDX-License-Identifier: Apache-2.0
"""Bags with motor commands beside rotor speeds, or that stop."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from quadpi_core.logs import bag_files, read_recording
from quadpi_core.paths import bags_directory
from quadpi_core.reading_options import ReadingOptions, TimeRange
from quadpi_core.vehicle import Motors, Vehicle

from ..commanded_bags import write_bag
from ..messages.adapters.vendor_messages import DEFINITIONS, Messages

BEBOP = Vehicle.load("bebop2")


@pytest.fixture(scope="module")
def recording():
    part = ReadingOptions(part=TimeRange(0.0, 4.0))
    return replace(read_recording(bags_directory() / "train_1.mcap", BEBOP, part), name="train_1")


def test_commands_whose_motors_a_vehicle_does_not_fit_refuse_no_bag_with_rotor_speeds(recording, tmp_path):
    bag = write_bag(tmp_path / "bag", Messages(DEFINITIONS), recording, "px4_motors", measured=True)
    ring = 0.1 * np.array([[1.0, 0.0, 0.0], [0.0, 1.0, 0.0], [-1.0, 0.0, 0.0], [0.0, -1.0, 0.0]])
    read = read_recording(bag, replace(BEBOP, rotor_positions=ring))
    assert read.commands is None
    np.testing.assert_array_equal(read.rotor_speeds.speeds, recording.rotor_speeds.speeds)


def test_no_measured_speed_stands_in_where_commands_stop(recording, tmp_path, monkeypatch):
    monkeypatch.setattr(bag_files, "BLOCK_MESSAGES", 500)
    messages = Messages(DEFINITIONS)
    bag = write_bag(tmp_path / "bag", messages, recording, "px4_motors", measured=True, commanded_s=2.0)
    motors = Motors(source="px4_motors", coefficients=((100.0, 1000.0, 0.0, 0.0, 0.0),) * 4, lag_s=0.0)
    read = read_recording(bag, replace(BEBOP, motors=motors))
    assert read.commanded
    np.testing.assert_array_equal(read.rotor_speeds.time_ns, read.commands.time_ns)
    assert len(read.commands) == 500
