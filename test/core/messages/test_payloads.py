# SPDX-FileCopyrightText: 2026 The quadpi authors
# SPDX-License-Identifier: Apache-2.0
"""Messages in one buffer: whatever is done to them, they are those of a list of bytes."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.spatial.transform import Rotation

from quadpi_core.core import compiled
from quadpi_core.messages import payloads
from quadpi_core.messages.definitions import codec
from quadpi_core.messages.payloads import Payloads, Topic, join_topics
from quadpi_core.messages.sensor_messages import ODOMETRY, PREDICTION

MESSAGES = st.lists(st.binary(max_size=9), min_size=1, max_size=12)


@settings(deadline=None)
@given(MESSAGES, st.data())
def test_a_buffer_is_a_list_of_messages(messages, data):
    payloads = Payloads.join(messages)
    assert (len(payloads), list(payloads)) == (len(messages), messages)
    assert [payloads[index] for index in range(len(messages))] == messages
    order = np.array(data.draw(st.lists(st.integers(0, len(messages) - 1), max_size=12)), dtype=np.int64)
    taken = payloads.take(order)
    expected = [messages[index] for index in order]
    assert list(taken) == list(taken.compact()) == expected
    assert taken.compact().data.size == sum(map(len, expected))
    assert list(taken.compact(3)) == [message[:3] for message in expected]
    start, stop = sorted(data.draw(st.tuples(st.integers(0, 12), st.integers(0, 12))))
    cut = taken.cut(slice(start, stop))
    assert list(cut) == expected[start:stop]
    assert list(Payloads.concatenate([payloads, cut, taken])) == messages + expected[start:stop] + expected


def test_a_cut_holds_no_more_of_the_buffer_than_its_messages_span():
    """A bag is read in blocks: one that held the whole chunk would hold the flight."""
    payloads = Payloads.join([b"aaaa", b"bb", b"", b"cccccc"])
    assert payloads.cut(slice(1, 3)).data.tobytes() == b"bb"
    assert payloads.cut(slice(2, 2)).data.size == 0
    assert payloads.take(np.array([3, 1])).cut(slice(None)).data.tobytes() == b"bbcccccc"


def test_rows_of_messages_of_one_length():
    rows = np.arange(12, dtype=np.uint8).reshape(3, 4)
    payloads = Payloads.from_rows(rows)
    assert list(payloads) == [bytes(row) for row in rows]
    np.testing.assert_array_equal(payloads.rows(np.arange(3), 4), rows)
    np.testing.assert_array_equal(payloads.rows(np.array([2, 0]), 3), rows[[2, 0], :3])


def topic(*times_ns):
    """Each message says its log time."""
    return Topic("/a", "b", np.array(times_ns), Payloads.join([str(time).encode() for time in times_ns]))


def test_a_topic_is_split_before_the_first_message_at_an_instant():
    before, after = topic(10, 20, 20, 30).split(20)
    assert (list(before.payloads), list(after.payloads)) == ([b"10"], [b"20", b"20", b"30"])
    np.testing.assert_array_equal(after.log_time_ns, [20, 20, 30])


@pytest.mark.parametrize("count", [1, 3])
def test_parts_are_joined_in_the_order_of_their_log_times_and_equal_ones_in_that_of_the_parts(count):
    second = Topic("/a", "b", np.array([5, 20]), Payloads.join([b"5", b"twenty"]))
    whole = join_topics([topic(10, 20, 30), second, topic(1)][:count])
    times = [10, 20, 30] if count == 1 else [1, 5, 10, 20, 20, 30]
    assert whole.log_time_ns.tolist() == times
    expected = [str(time).encode() for time in times]
    assert list(whole.payloads) == (expected if count == 1 else [*expected[:4], b"twenty", b"30"])
    assert (whole.name, whole.type_name) == ("/a", "b")


def test_an_empty_topic_has_no_messages():
    assert (len(Topic.empty("/a", "b").payloads), Topic.empty("/a", "b").log_time_ns.dtype) == (0, np.int64)


@pytest.mark.parametrize(
    ("start", "target", "length"),
    [
        (-1, 0, 1),
        (0, -1, 1),
        (0, 0, -1),
        (5, 0, 1),
        (3, 0, 2),
        (0, 3, 2),
        (2**62, 0, 2**62),
        (2, 0, 2**63 - 1),
    ],
)
def test_no_byte_outside_a_buffer_is_read_or_written(start, target, length):
    data, room = np.arange(4, dtype=np.uint8), np.full(4, 9, dtype=np.uint8)
    starts, targets, lengths = (np.array([number]) for number in (start, target, length))
    with pytest.raises(ValueError, match="a message outside its buffer"):
        compiled.copy_spans(data, starts, room, targets, lengths)
    assert room.tolist() == [9, 9, 9, 9]


# Kernels that convert a message's numbers in one call, against the conversions of frames one by one.


N = 8
# FRD in FLU, and NED in ENU, as columns.
BODY = np.diag([1.0, -1.0, -1.0])
WORLD = np.array([[0.0, 1.0, 0.0], [1.0, 0.0, 0.0], [0.0, 0.0, -1.0]])


@pytest.fixture
def rng():
    return np.random.default_rng(8)


@pytest.fixture
def state(rng):
    """Position, attitude, velocity and rates, FRD and NED."""
    position, velocity, rates = rng.normal(size=(3, N, 3))
    return position, Rotation.random(N, rng), velocity, rates


def covariance(rng):
    roots = rng.normal(size=(N, 6, 6))
    return roots @ np.swapaxes(roots, 1, 2)


def test_sizes_are_those_of_the_messages():
    for kind, count in ((ODOMETRY, payloads.ODOMETRY_VALUES), (PREDICTION, payloads.PREDICTION_VALUES)):
        assert max(place.stop for place in codec(kind).places.values()) == count


def test_odometry_is_that_of_rotation_matrices(state, rng):
    """Also its covariances, which turn with the axes that they are of."""
    pose, twist, places = covariance(rng), covariance(rng), codec(ODOMETRY).places
    position, attitude, velocity, rates = state
    numbers = np.full((N, payloads.ODOMETRY_VALUES), np.nan)
    wxyz = attitude.as_quat(scalar_first=True)
    compiled.odometry_values(position, wxyz, velocity, rates, pose, twist, numbers)
    np.testing.assert_array_equal(numbers[:, places["pose.pose.position"]], position @ WORLD.T)
    np.testing.assert_array_equal(numbers[:, places["twist.twist.linear"]], velocity @ BODY)
    np.testing.assert_array_equal(numbers[:, places["twist.twist.angular"]], rates @ BODY)
    sent = Rotation.from_quat(numbers[:, places["pose.pose.orientation"]])
    np.testing.assert_allclose(sent.as_matrix(), WORLD @ attitude.as_matrix() @ BODY, atol=1e-14)
    both = np.kron(np.eye(2), WORLD), np.kron(np.eye(2), BODY)
    for name, turn, own in (("pose", both[0], pose), ("twist", both[1], twist)):
        found = numbers[:, places[f"{name}.covariance"]].reshape(N, 6, 6)
        np.testing.assert_allclose(found, turn @ own @ turn.T, rtol=1e-15)


@pytest.mark.parametrize(("norm", "first"), [(1.049, -1), (0.951, -1), (1.051, 2), (0.949, 2), (0.0, 2)])
def test_an_orientation_is_scaled_to_unit_length_if_it_is_off_by_a_twentieth_at_most(state, norm, first):
    sent = np.zeros((N, 7))
    sent[:, 3:] = state[1].as_quat()
    sent[2] *= norm
    attitude = np.empty((N, 4))
    assert compiled.pose_values(sent, np.empty((N, 3)), attitude) == first
    rows = slice(None) if first < 0 else slice(0, first)
    np.testing.assert_allclose(np.linalg.norm(attitude[rows], axis=1), 1.0)
