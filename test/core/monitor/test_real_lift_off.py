# SPDX-FileCopyrightText: 2026 The quadpi authors
# SPDX-License-Identifier: Apache-2.0
"""Real flights that the alarm was silent on: without the load of training, with a rotor sensor that fails."""

from __future__ import annotations

import numpy as np
import pytest

from quadpi_core.logs import read_recording
from quadpi_core.logs.bags import read_outputs
from quadpi_core.results import BAD_DATA, CAUSES, LEVEL_ALARM
from quadpi_core.vehicle import Vehicle

CRAZYFLIE = ("--vehicle", "crazyflie_rpm")
# The rate of the IMU is measured in the first second.
JUDGED_FROM_S = 1.0


def replayed(quadpi, tmp_path, trained, flights):
    """Alarm rows of flights by a model, with the flight and seconds since its first IMU sample."""
    ran = quadpi("identify", *trained, *CRAZYFLIE, "--method", "polynomial", "-o", tmp_path / "model")
    assert ran.status == 0, ran.errors
    for flight in flights:
        bag = tmp_path / f"{flight.name}.mcap"
        assert quadpi("replay", tmp_path / "model", flight, "-o", bag).status == 0
        recording = read_recording(flight, Vehicle.load("crazyflie_rpm"))
        _, alarms = read_outputs(bag)
        yield recording, alarms, 1e-9 * (alarms.time_ns - recording.imu.time_ns[0])


@pytest.mark.slow
def test_a_model_of_the_loaded_vehicle_contradicts_the_bare_one_within_two_seconds(
    quadpi, shared_data, tmp_path
):
    loaded = [shared_data / "imrc_payload" / f"eckart{k}" for k in (14, 15, 17, 18, 19, 20, 21, 22, 24, 27)]
    bare = sorted((shared_data / "imrc_brushless").iterdir())
    assert len(bare) == 20
    for recording, alarms, seconds in replayed(quadpi, tmp_path, loaded, bare):
        raised = alarms.level == LEVEL_ALARM
        assert raised.any(), recording.source
        assert seconds[np.argmax(raised)] < 2.0, recording.source


@pytest.mark.slow
def test_a_dead_rotor_sensor_is_bad_data_within_0_3_s_of_its_first_zero(quadpi, shared_data, tmp_path):
    folder = shared_data / "imrc_brushed"
    sound = [folder / name for name in ("jana00", "jana02", "jana03", "jana10")]
    dead = [folder / name for name in ("jana20", "jana23", "jana24", "jana27")]
    for recording, alarms, seconds in replayed(quadpi, tmp_path, sound, dead):
        rotors = recording.rotor_speeds
        at_s = 1e-9 * (rotors.time_ns - recording.imu.time_ns[0])
        zero_s = at_s[(at_s > JUDGED_FROM_S) & (rotors.speeds.min(axis=1) < 1.0)][0]
        raised = alarms.cause_level[:, CAUSES.index(BAD_DATA)] == LEVEL_ALARM
        assert raised.any(), recording.source
        first = int(np.argmax(raised))
        assert seconds[first] < zero_s + 0.3, recording.source
        assert "rotor 1 reads 0" in alarms.reasons[first]
        assert not any("stopped" in word for words in alarms.reasons for word in words)
