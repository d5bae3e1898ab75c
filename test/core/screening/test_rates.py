# SPDX-FileCopyrightText: 2026 The quadpi authors
# SPDX-License-Identifier: Apache-2.0
"""Topics that come too seldom are named with both rates and what to set, by import and by refusals."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from quadpi_core.errors import LogError
from quadpi_core.estimator.fusion import require_streams
from quadpi_core.flight import OdometryStream, Recording
from quadpi_core.logs import read_recording
from quadpi_core.logs.readers import log_formats
from quadpi_core.monitor.replay import follow, recorded_flight
from quadpi_core.screening.flight_runs import parts_without_pause
from quadpi_core.screening.plausibility import missing_topics
from quadpi_core.vehicle import Vehicle

BAG = Path(__file__).parents[3] / "bags" / "train_1.mcap"
BEBOP = Vehicle.load("bebop2")
USES = "rules out identification, prediction and replay, which need"


@pytest.fixture(scope="module")
def flown() -> Recording:
    return read_recording(BAG, Vehicle.load("bebop2"))


def at(recording: Recording, topic: str, rate_hz: float, jitter_s: float = 0.004) -> Recording:
    """A recording with a topic at another rate; odometry stands for the poses."""
    if topic == "odometry":
        pose = recording.pose
        state = OdometryStream(
            pose.time_ns, pose.position, pose.attitude, 0.0 * pose.position, 0.0 * pose.position
        )
        recording = replace(recording, pose=None, odometry=state)
    stream = getattr(recording, topic)
    seconds = 1e-9 * (stream.time_ns - stream.time_ns[0])
    due = np.arange(0.0, seconds[-1], 1.0 / rate_hz)
    due += np.random.default_rng(0).uniform(0.0, jitter_s, len(due))
    rows = np.unique(np.searchsorted(seconds, due))
    return replace(recording, **{topic: stream.take(rows)}, arrivals={}, remedies={stream.topic: "set MORE"})


@pytest.mark.parametrize(
    ("topic", "rate_hz", "said"),
    [
        ("pose", 0.5, f"mocap/pose at 0.499 Hz: {USES} 0.9 Hz or more (in longer pauses an estimate drifts"),
        ("odometry", 0.5, f"odometry at 0.499 Hz: {USES} 0.9 Hz or more"),
        ("rotor_speeds", 4.0, f"rotor_speeds at 4 Hz: {USES} 12 Hz or more"),
    ],
)
def test_a_topic_that_comes_too_seldom_is_named_with_what_to_set(flown, topic, rate_hz, said):
    slow = at(flown, topic, rate_hz)
    (sentence,) = [one for one in missing_topics(slow) if USES in one]
    assert sentence.startswith(said)
    assert sentence.endswith("; set MORE")
    assert parts_without_pause(slow) == [slow]
    with pytest.raises(LogError, match=f"^{BAG}: topic ") as refusal:
        require_streams(slow)
    assert sentence in str(refusal.value)


def test_a_replay_says_it_too(flown):
    begin_ns = flown.imu.time_ns[0]
    streams = {name: getattr(flown, name) for name in ("imu", "rotor_speeds", "pose")}
    begun = {name: stream.take(stream.time_ns < begin_ns + 4 * 10**9) for name, stream in streams.items()}
    slow = at(replace(flown, **begun), "pose", 0.6)
    with pytest.raises(LogError, match=r"topic mocap/pose at 0\.6\d* Hz: rules out"):
        list(follow(recorded_flight(slow, BEBOP), BEBOP))


@pytest.mark.parametrize(("topic", "rate_hz"), [("pose", 5.0), ("odometry", 5.0), ("rotor_speeds", 30.0)])
def test_faster_topics_are_not_named(flown, topic, rate_hz):
    assert not [one for one in missing_topics(at(flown, topic, rate_hz)) if USES in one]


def test_formats_of_autopilots_name_what_to_set():
    named = {one.description.split(" ")[0]: one.remedies for one in log_formats() if one.remedies}
    assert {"PX4", "ArduPilot", "Betaflight", "Crazyflie", "MAVLink", "bag"} <= named.keys()
    assert "DSHOT_TEL_CFG" in named["PX4"]["rotor_speeds"]
    assert "SDLOG_PROFILE" in named["PX4"]["odometry"]
    assert "LOG_BITMASK" in named["ArduPilot"]["odometry"]
    assert "blackbox_sample_rate" in named["Betaflight"]["rotor_speeds"]
    assert "MAV_CMD_SET_MESSAGE_INTERVAL" in named["MAVLink"]["odometry"]
