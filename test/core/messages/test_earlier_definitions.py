# SPDX-FileCopyrightText: 2026 The quadpi authors
# SPDX-License-Identifier: Apache-2.0
"""Messages of the definitions before are those of today, whoever wrote them: here rosbags does."""

from __future__ import annotations

import numpy as np
import pytest

from quadpi_core.errors import LogError
from quadpi_core.messages.definitions import definition_text
from quadpi_core.messages.earlier_definitions import is_earlier, rewritten
from quadpi_core.messages.payloads import Payloads, Topic
from quadpi_core.messages.result_messages import unpack_model, unpack_predictions
from quadpi_core.messages.sensor_messages import ERPM, PREDICTION, ROTOR_SPEEDS, unpack_rotor_speeds

from ..earlier_messages import FIELDS, WRENCHES, earlier_definition, earlier_messages

N = 5
SPEEDS = np.random.default_rng(3).uniform(0.0, 900.0, (N, 4))


@pytest.mark.parametrize("type_name", FIELDS)
def test_definitions_of_four_rotors_are_earlier_and_those_of_today_are_not(type_name: str) -> None:
    assert is_earlier(type_name, earlier_definition(type_name))
    assert not is_earlier(type_name, definition_text(type_name))
    assert not is_earlier(type_name, "")
    assert not is_earlier("others/msg/Rotors", earlier_definition(type_name))


@pytest.mark.parametrize("frame", ["", "b", "base", "based", "base_l", "base_link"])
def test_rotor_speeds_of_an_earlier_definition_are_kept(frame: str) -> None:
    frames = ["base_link", frame, "map", frame, frame]
    topic = Topic("/rotor_speeds", ROTOR_SPEEDS, np.arange(N), earlier_messages(ROTOR_SPEEDS, frames, SPEEDS))
    now = rewritten(topic)
    assert (now.name, now.type_name, now.log_time_ns.tolist()) == (topic.name, ROTOR_SPEEDS, list(range(N)))
    rotors = unpack_rotor_speeds(now.payloads)
    np.testing.assert_array_equal(rotors.speeds, SPEEDS)
    assert rotors.time_ns.tolist() == [second * 10**9 + 7 for second in range(N)]
    assert all(name.encode() in message for name, message in zip(frames, now.payloads, strict=True))


def test_a_topic_without_messages_stays_one() -> None:
    assert len(rewritten(Topic.empty("/erpm", ERPM)).payloads) == 0


def test_damaged_messages_are_refused_by_topic_and_sample() -> None:
    whole = earlier_messages(ERPM, ["base_link"] * 3, SPEEDS)
    cut = Payloads.join([whole[0], whole[1], whole[2][:-9]])
    with pytest.raises(LogError, match="topic /uav/erpm: sample 12: 51 bytes where quadpi/msg/Erpm takes 60"):
        rewritten(Topic("/uav/erpm", ERPM, np.arange(3), cut), before=10)


def test_predictions_had_the_same_bytes() -> None:
    """Six scalars became a wrench, a force and a torque: CDR has no trace of that."""
    rng = np.random.default_rng(8)
    wrenches = {name: rng.normal(size=(N, 6)) for name in WRENCHES}
    scalars = np.hstack(list(wrenches.values())).T
    axes = np.full(N, 0b101, np.uint8)
    payloads = earlier_messages(
        PREDICTION, ["base_link"] * N, ["poly@0123456789ab"] * N, [0.9] * N, axes, *scalars
    )
    found = unpack_predictions(payloads)
    signs = np.tile([1.0, -1.0, -1.0], 2)
    np.testing.assert_array_equal(found.predicted, signs * wrenches["predicted"])
    np.testing.assert_array_equal(found.measured, signs * wrenches["measured"])
    np.testing.assert_array_equal(found.relative_width, wrenches["relative_width"])
    np.testing.assert_array_equal(found.lower[:, 0], wrenches["lower"][:, 0])
    np.testing.assert_array_equal(found.lower[:, 5], -wrenches["upper"][:, 5])
    about = unpack_model(payloads[0])
    assert (about.identity, about.confidence, about.axes) == ("poly@0123456789ab", 0.9, ("Fx", "Fz"))
