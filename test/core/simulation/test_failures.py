# SPDX-FileCopyrightText: 2026 The quadpi authors
# SPDX-License-Identifier: Apache-2.0
import json
from dataclasses import fields

import numpy as np
import pytest

from quadpi_core.config_schema import parse_config
from quadpi_core.errors import SimulationError
from quadpi_core.flight import ImuStream, PoseStream, RotorSpeedStream, WindStream
from quadpi_core.simulation.sensors import KINDS, SIGNALS, Fault, Sent, apply_faults

START_NS, STEP_NS, N = 5_000_000_000, 2_000_000, 1000
END_NS = START_NS + STEP_NS * (N - 1)
FIRST, LAST = 500, 600  # of the window


@pytest.fixture
def sent():
    rng = np.random.default_rng(3)
    time_ns = START_NS + STEP_NS * np.arange(N)

    def taken(stream, delay_ns=0):
        return Sent(stream, time_ns, time_ns + delay_ns)

    return {
        "imu": taken(ImuStream(time_ns, *rng.normal(size=(2, N, 3)))),
        "rotor_speeds": taken(RotorSpeedStream(time_ns, rng.uniform(300, 900, size=(N, 4)))),
        "mocap/pose": taken(PoseStream(time_ns, rng.normal(size=(N, 3)), rng.normal(size=(N, 4))), 8_000_000),
        "wind": taken(WindStream(time_ns, rng.normal(size=(N, 3)))),
    }


def read_faults(data, where):
    return parse_config(tuple[Fault, ...], data, where, SimulationError)


def read(**entry):
    (fault,) = read_faults([{"at_s": 1.0, "for_s": 0.2, **entry}], "s.yaml: flights.x.faults")
    return fault


def failed(sent, **entry):
    """What is sent on the topic of the fault; everything outside its window and topic must be as before."""
    fault = read(**entry)
    altered = apply_faults([fault], sent, START_NS, END_NS)
    for topic, before in sent.items():
        after = altered[topic]
        if topic != fault.topic:
            assert after is before
            continue
        outside = np.r_[0:FIRST, LAST:N]
        left = np.isin(after.taken_ns, before.taken_ns[outside])
        np.testing.assert_array_equal(after.taken_ns[left], before.taken_ns[outside])
        np.testing.assert_array_equal(after.arrival_ns[left], before.arrival_ns[outside])
        for column in fields(before.stream):
            np.testing.assert_array_equal(
                getattr(after.stream, column.name)[left], getattr(before.stream, column.name)[outside]
            )
    return altered[fault.topic]


EXAMPLES = {
    "not_finite": {"topic": "imu", "signal": "angular_velocity"},
    "frozen": {"topic": "rotor_speeds", "rotors": [2, 3]},
    "dropout": {"topic": "mocap/pose"},
    "spike": {"topic": "imu", "size_m_s2": 30.0},
    "half_reading": {"topic": "rotor_speeds", "rotors": [4]},
    "swapped": {"topic": "rotor_speeds", "rotors": [1, 3]},
    "jump": {"topic": "mocap/pose", "size_m": -0.5},
    "stamps_repeated": {"topic": "wind"},
    "stamps_backward": {"topic": "imu", "size_s": 0.05},
}


def test_every_kind_has_an_example():
    assert EXAMPLES.keys() == KINDS.keys()


@pytest.mark.parametrize("kind", EXAMPLES)
def test_a_fault_alters_its_window_alone_and_survives_json(kind, sent):
    after = failed(sent, kind=kind, **EXAMPLES[kind])
    fault = read(kind=kind, **EXAMPLES[kind])
    before = sent[fault.topic]
    assert any(
        not np.array_equal(getattr(after.stream, column.name), getattr(before.stream, column.name))
        for column in fields(before.stream)
    )
    entry = json.loads(json.dumps(fault.as_dict(), allow_nan=False))
    assert entry == {"kind": kind, "at_s": 1.0, "for_s": 0.2, **EXAMPLES[kind]}
    assert read_faults([entry], "x") == (fault,)


def test_not_finite_confined_to_one_signal(sent):
    after = failed(sent, kind="not_finite", topic="imu", signal="specific_force").stream
    assert np.isnan(after.specific_force[FIRST:LAST]).all()
    assert np.isfinite(after.angular_velocity).all()


def test_not_finite_of_a_whole_topic(sent):
    after = failed(sent, kind="not_finite", topic="mocap/pose").stream
    assert np.isnan(after.position[FIRST:LAST]).all()
    assert np.isnan(after.attitude[FIRST:LAST]).all()


def test_frozen_holds_the_last_good_sample(sent):
    before, after = sent["imu"].stream, failed(sent, kind="frozen", topic="imu").stream
    assert (after.angular_velocity[FIRST:LAST] == before.angular_velocity[FIRST - 1]).all()
    assert (after.specific_force[FIRST:LAST] == before.specific_force[FIRST - 1]).all()
    np.testing.assert_array_equal(after.time_ns, before.time_ns)


def test_frozen_from_the_start_holds_the_first_sample(sent):
    fault = Fault("frozen", "wind", at_s=0.0, for_s=0.1)
    after = apply_faults([fault], sent, START_NS, END_NS)["wind"].stream
    assert (after.velocity[:50] == sent["wind"].stream.velocity[0]).all()
    assert (after.velocity[50] == sent["wind"].stream.velocity[50]).all()


def test_dropout_sends_nothing(sent):
    after = failed(sent, kind="dropout", topic="mocap/pose")
    assert len(after.stream) == len(after.arrival_ns) == N - (LAST - FIRST)
    assert np.max(np.diff(after.taken_ns)) == STEP_NS * (LAST - FIRST + 1)


def test_spikes_are_isolated_samples(sent):
    before, after = (
        sent["rotor_speeds"].stream,
        failed(sent, kind="spike", topic="rotor_speeds", rotors=[2], size_rad_s=6e5).stream,
    )
    off = np.flatnonzero(after.speeds[:, 1] != before.speeds[:, 1])
    np.testing.assert_array_equal(off, np.arange(FIRST, LAST, 10))
    np.testing.assert_array_equal(after.speeds[off, 1], before.speeds[off, 1] + 6e5)
    np.testing.assert_array_equal(after.speeds[:, [0, 2, 3]], before.speeds[:, [0, 2, 3]])


def test_unit_of_a_spike_names_its_signal(sent):
    after = failed(sent, kind="spike", topic="imu", size_rad_s=100.0).stream
    np.testing.assert_array_equal(after.specific_force, sent["imu"].stream.specific_force)
    assert (np.abs(after.angular_velocity[FIRST]) > 50.0).all()


def test_half_reading_of_one_rotor_or_all(sent):
    before = sent["rotor_speeds"].stream.speeds
    one = failed(sent, kind="half_reading", topic="rotor_speeds", rotors=[3]).stream.speeds
    np.testing.assert_array_equal(one[FIRST:LAST], before[FIRST:LAST] * [1, 1, 0.5, 1])
    every = failed(sent, kind="half_reading", topic="rotor_speeds").stream.speeds
    np.testing.assert_array_equal(every[FIRST:LAST], 0.5 * before[FIRST:LAST])


def test_swapped_exchanges_two_rotors(sent):
    before = sent["rotor_speeds"].stream.speeds
    after = failed(sent, kind="swapped", topic="rotor_speeds", rotors=[4, 1]).stream.speeds
    np.testing.assert_array_equal(after[FIRST:LAST], before[FIRST:LAST][:, [3, 1, 2, 0]])


def test_jump_moves_the_position_north(sent):
    before, after = (
        sent["mocap/pose"].stream,
        failed(sent, kind="jump", topic="mocap/pose", size_m=0.5).stream,
    )
    np.testing.assert_array_equal(
        after.position[FIRST:LAST], before.position[FIRST:LAST] + np.array([0.5, 0, 0])
    )
    np.testing.assert_array_equal(after.attitude, before.attitude)


def test_stamps_fail_while_messages_arrive_as_ever(sent):
    before = sent["imu"]
    stuck = failed(sent, kind="stamps_repeated", topic="imu")
    assert (stuck.stream.time_ns[FIRST:LAST] == before.taken_ns[FIRST - 1]).all()
    back = failed(sent, kind="stamps_backward", topic="imu", size_s=0.05)
    assert (back.stream.time_ns[FIRST:LAST] == before.taken_ns[FIRST:LAST] - 50_000_000).all()
    for after in (stuck, back):
        np.testing.assert_array_equal(after.arrival_ns, before.arrival_ns)


def test_faults_add_up_and_windows_are_of_the_true_instants(sent):
    faults = read_faults(
        [
            {"kind": "stamps_backward", "topic": "imu", "at_s": 1.0, "for_s": 0.2, "size_s": 0.5},
            {"kind": "not_finite", "topic": "imu", "at_s": 1.1, "for_s": 0.2},
        ],
        "x",
    )
    after = apply_faults(faults, sent, START_NS, END_NS)["imu"].stream
    np.testing.assert_array_equal(np.flatnonzero(np.isnan(after.angular_velocity[:, 0])), np.arange(550, 650))


def test_fault_of_an_absent_topic_or_after_the_end(sent):
    still = {topic: stream for topic, stream in sent.items() if topic != "wind"}
    with pytest.raises(SimulationError, match=r"fault frozen of topic wind at 1 s: the flight has no such"):
        apply_faults([read(kind="frozen", topic="wind")], still, START_NS, END_NS)
    with pytest.raises(
        SimulationError, match=r"fault dropout of topic imu at 9 s: the flight lasts 1\.998 s"
    ):
        apply_faults([read(kind="dropout", topic="imu", at_s=9)], sent, START_NS, END_NS)


@pytest.mark.parametrize(
    ("entry", "message"),
    [
        ({"kind": "frosen", "topic": "imu"}, r"`kind` must be one of .*did you mean `frozen`\?"),
        ({"topic": "imu"}, "missing key `kind`"),
        ({"kind": "dropout"}, "missing key `topic`"),
        ({"kind": "dropout", "topic": "mocap"}, r"`topic` must be one of .*did you mean `mocap/pose`\?"),
        ({"kind": "half_reading", "topic": "imu"}, "`topic` must be one of rotor_speeds, found 'imu'"),
        ({"kind": "dropout", "topic": "imu", "fors": 1}, r"unknown key `fors`; .*did you mean `for_s`\?"),
        (
            {"kind": "dropout", "topic": "imu", "at_s": -1},
            "`at_s` must be a number from 0 to 1e.06, found -1",
        ),
        (
            {"kind": "dropout", "topic": "imu", "for_s": "1"},
            "`for_s` must be a number from 0 to 1e.06, found '1'",
        ),
        ({"kind": "dropout", "topic": "imu", "for_s": None}, "missing key `for_s`"),
        ({"kind": "frozen", "topic": "imu", "signal": "gyro"}, "`signal` must be one of angular_velocity, "),
        ({"kind": "frozen", "topic": "imu", "rotors": [1]}, "unknown key `rotors`"),
        ({"kind": "frozen", "topic": "rotor_speeds", "rotors": [0]}, r"`rotors` must list .*found \[0\]"),
        ({"kind": "frozen", "topic": "rotor_speeds", "rotors": [2, 2]}, "`rotors` must list different num"),
        ({"kind": "swapped", "topic": "rotor_speeds", "rotors": [1]}, "`rotors` must list 2 different num"),
        ({"kind": "swapped", "topic": "rotor_speeds"}, "`rotors` must list 2 different numbers from 1 to 4"),
        ({"kind": "spike", "topic": "imu"}, "spike of imu needs `size_rad_s` or `size_m_s2`"),
        ({"kind": "spike", "topic": "imu", "size_rad_s": 1, "size_m_s2": 1}, "spike of imu needs"),
        ({"kind": "spike", "topic": "wind", "size_m": 1}, r"unknown key `size_m`; .*did you mean `size_m_s`"),
        (
            {"kind": "stamps_backward", "topic": "imu", "size_s": -1},
            "`size_s` must be a number from 0 to 1e.06",
        ),
    ],
)
def test_impossible_entries_are_named(entry, message):
    data = {"at_s": 1.0, "for_s": 0.2, **entry}
    with pytest.raises(SimulationError, match=rf"^s\.yaml: faults: entry 2: .*{message}"):
        read_faults([{"kind": "dropout", "topic": "imu", "at_s": 0, "for_s": 1}, data], "s.yaml: faults")


@pytest.mark.parametrize("data", [{"kind": "dropout"}, "dropout"])
def test_faults_are_a_list(data):
    with pytest.raises(SimulationError, match=r"^x: must be a list, found"):
        read_faults(data, "x")


def test_entry_is_a_mapping():
    with pytest.raises(SimulationError, match=r"^x: entry 1: expected keys and values, found 'dropout'"):
        read_faults(["dropout"], "x")


def test_signals_are_fields_of_the_streams(sent):
    for topic, signals in SIGNALS.items():
        columns = {column.name for column in fields(sent[topic].stream)} - {"time_ns", "deviation"}
        assert columns == set(signals)
