# SPDX-FileCopyrightText: 2026 The quadpi authors
# SPDX-License-Identifier: Apache-2.0
"""Results of the monitor as ROS messages, as rosbags reads them, and back."""

import numpy as np
import pytest

from quadpi_core.flight import AXES
from quadpi_core.inputs import INPUT_NAMES
from quadpi_core.messages import result_messages, sensor_messages
from quadpi_core.messages.definitions import typestore
from quadpi_core.messages.frame_ids import TF_TYPE
from quadpi_core.monitor.alarm_log import Explained, reasons
from quadpi_core.monitor.change import found_columns, nothing_found
from quadpi_core.monitor.preparation import GYRO_FROZEN
from quadpi_core.results import AlarmEvent, Alarms, Predictions

from .test_sensor_messages import TIME_NS, N, assert_same, reference


@pytest.fixture
def rng():
    return np.random.default_rng(5)


def test_bounds_swap_on_axes_that_change_sign(rng):
    predicted = rng.normal(size=(N, 6))
    predictions = Predictions(
        time_ns=TIME_NS,
        predicted=predicted,
        lower=predicted - rng.uniform(0.1, 1.0, size=(N, 6)),
        upper=predicted + rng.uniform(1.1, 2.0, size=(N, 6)),
        measured=rng.normal(size=(N, 6)),
        relative_width=rng.uniform(size=(N, 6)),
    )
    payloads = result_messages.pack_predictions(
        predictions, model="poly 0123456789ab", confidence=0.95, axes=AXES
    )
    for sample, one in enumerate(reference(payloads, sensor_messages.PREDICTION)):
        assert one.lower.force.x == predictions.lower[sample, 0]
        assert one.lower.force.y == -predictions.upper[sample, 1]
        assert one.upper.torque.z == -predictions.lower[sample, 5]
        assert one.lower.force.z <= one.predicted.force.z <= one.upper.force.z
        assert one.measured.torque.y == -predictions.measured[sample, 4]
        assert one.relative_width[4] == predictions.relative_width[sample, 4]
        assert (one.model, one.confidence, one.axes) == ("poly 0123456789ab", 0.95, 63)
    assert_same(result_messages.unpack_predictions(payloads), predictions)


def test_axes_that_are_not_held_stay_plain_zero():
    zeros = np.zeros((N, 6))
    payloads = result_messages.pack_predictions(
        Predictions(TIME_NS, zeros, zeros, zeros, zeros, zeros), model="m", confidence=0.9, axes=()
    )
    one = typestore().deserialize_cdr(payloads[0], sensor_messages.PREDICTION)
    assert not np.signbit(one.upper.force.y)


def test_alarms_name_the_inputs_outside_farthest_first(rng):
    excess = np.zeros((N, len(INPUT_NAMES)))
    excess[1, INPUT_NAMES.index("u")] = 0.25
    excess[2, [INPUT_NAMES.index("u"), INPUT_NAMES.index("mu_x")]] = 0.25, 0.5
    excess[5] = excess[1]
    found = nothing_found(N)
    found["direction"][2], found["since_ns"][2], found["size"][2] = 2, 5_000_000_001, 0.25
    alarms = Alarms(
        time_ns=TIME_NS,
        level=rng.integers(0, 3, N).astype(np.uint8),
        causes=rng.integers(0, 16, N).astype(np.uint8),
        cause_level=rng.integers(0, 3, (N, 4)).astype(np.uint8),
        cause_health=rng.integers(0, 4, (N, 4)).astype(np.uint8),
        cause_evidence=rng.random((N, 4)),
        leverage=rng.normal(size=(N, 6)),
        leverage_ratio=rng.uniform(0.0, 4.0, (N, 6)),
        width=rng.normal(size=(N, 6)),
        width_ratio=rng.uniform(0.0, 2.0, (N, 6)),
        miscoverage=rng.random((N, 6)),
        miss_share=rng.random((N, 6)),
        **found_columns(found, None),
        input_score=(1.0 + 2.0 * excess) / 1.2,
        input_excess=excess,
        faults=np.full(N, GYRO_FROZEN),
        more_faults=np.zeros((N, 2), dtype=np.int64),
        stopped=np.zeros(N, dtype=np.int64),
        why_not_judged=np.zeros(N, dtype=np.int64),
        not_judged_share=np.zeros(N),
    )
    payloads = result_messages.pack_alarms(alarms, Explained().rows(alarms))
    outside = [(), ("u",), ("mu_x", "u"), (), (), ("u",), ()]
    for sample, one in enumerate(reference(payloads, sensor_messages.ALARM)):
        assert tuple(one.inputs_outside) == outside[sample]
        assert (one.level, one.causes) == (alarms.level[sample], alarms.causes[sample])
        assert one.envelope_distance == excess[sample].max()
        np.testing.assert_array_equal(one.leverage, alarms.leverage[sample])
        for name in ("width", "cause_level", "cause_health", "cause_evidence", "miscoverage", "miss_share"):
            np.testing.assert_array_equal(getattr(one, name), getattr(alarms, name)[sample])
        for name in ("changed", "change_size", "change_lower", "change_upper", "change_from_start"):
            assert getattr(one, name) == getattr(alarms, name)[sample]
        assert tuple(one.reasons) == reasons(alarms, sample)
    unpacked = result_messages.unpack_alarms(payloads)
    assert unpacked.reasons == [reasons(alarms, sample) for sample in range(N)]
    assert any(unpacked.reasons)
    assert unpacked.inputs_outside == outside
    np.testing.assert_array_equal(unpacked.level, alarms.level)
    np.testing.assert_array_equal(unpacked.time_ns, TIME_NS)
    assert unpacked.change_since_ns.tolist() == [5_000_000_001 if row == 2 else 0 for row in range(N)]


def test_events_survive_their_message():
    events = [
        AlarmEvent(1, 1, 5_000_000_001, 5_000_000_001, 0, 1.5, ("u 1.4 x the training range", "gap")),
        AlarmEvent(1, 1, 7_000_000_001, 5_000_000_001, 7_000_000_001, 2.5, ()),
    ]
    payloads = result_messages.pack_events(events)
    for event, payload in zip(events, payloads, strict=True):
        one = typestore().deserialize_cdr(payload, sensor_messages.EVENT)
        assert (one.number, one.cause, one.peak_evidence) == (1, 1, event.peak_evidence)
        assert one.end.sec * 10**9 + one.end.nanosec == event.end_ns
        assert tuple(one.reasons) == event.reasons
    assert result_messages.unpack_events(payloads) == events


def test_the_residual_is_what_was_measured_less_what_was_predicted(rng):
    """In the axes of the message: forward, left, up."""
    predicted, measured = rng.normal(size=(2, N, 6))
    zeros = np.zeros((N, 6))
    found = result_messages.wrenches_of(Predictions(TIME_NS, predicted, zeros, zeros, measured, zeros))
    signs = np.tile([1.0, -1.0, -1.0], 2)
    np.testing.assert_array_equal(found["predicted"], signs * predicted)
    np.testing.assert_array_equal(found["measured"], signs * measured)
    np.testing.assert_allclose(found["residual"], signs * (measured - predicted), atol=1e-15)
    message = result_messages.wrench_message("uav/base_link")
    message.values[:] = found["residual"][2]
    one = typestore().deserialize_cdr(message.stamped(int(TIME_NS[2])), sensor_messages.WRENCH)
    assert one.header.frame_id == "uav/base_link"
    assert [one.wrench.force.x, one.wrench.torque.z] == found["residual"][2, [0, 5]].tolist()


@pytest.mark.parametrize(("world", "body"), [("map", "base_link"), ("earth", "uav1/base_link"), ("", "b")])
def test_a_transform_is_read_by_others(world, body):
    message = result_messages.transform_message(world, body)
    message.values[:] = [[1.0, -2.0, 3.0, 0.1, 0.2, 0.3, np.sqrt(1.0 - 0.14)]]
    for time_ns in (5_000_000_007, 6_999_999_999):
        payload = message.stamped(time_ns)
        read = typestore().deserialize_cdr(payload, TF_TYPE)
        assert bytes(typestore().serialize_cdr(read, TF_TYPE)) == payload
        (one,) = read.transforms
        assert 10**9 * one.header.stamp.sec + one.header.stamp.nanosec == time_ns
        assert (one.header.frame_id, one.child_frame_id) == (world, body)
        p, q = one.transform.translation, one.transform.rotation
        assert [p.x, p.y, p.z, q.x, q.y, q.z, q.w] == message.values[0].tolist()
