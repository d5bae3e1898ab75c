# SPDX-FileCopyrightText: 2026 The quadpi authors
# SPDX-License-Identifier: Apache-2.0
"""Transforms of tf: one child frame among others, each with its own stamp. See test_bag_inputs.py too."""

import numpy as np
import pytest

from quadpi_core.errors import SampleError
from quadpi_core.messages.adapters.adapter_settings import AdapterSettings, BodySettings
from quadpi_core.messages.adapters.packages.rigid_bodies import TF
from quadpi_core.messages.definitions import definition_text

from .vendor_messages import tf as message


def unpacker(frames="flu-enu"):
    settings = AdapterSettings(mocap=BodySettings(body="quad", frames=frames))
    return TF.open(definition_text(TF.type_name), settings, None)


LEVEL = (0.0, 0.0, 0.0, 1.0)


def test_each_transform_has_its_own_stamp_and_hidden_ones_are_counted():
    reading = unpacker()
    pose = reading.unpack(message(("wand", 1, (0, 0, 0), LEVEL), ("quad", 2, (1.0, 2.0, 3.0), LEVEL)))
    assert pose.time_ns.tolist() == [2_000_000_005]
    np.testing.assert_array_equal(pose.position, [[2.0, 1.0, -3.0]])
    assert len(reading.unpack(message(("wand", 3, (0, 0, 0), LEVEL)))) == 0
    assert len(reading.unpack(message(("quad", 4, (0, 0, 0), (0, 0, 0, 0))))) == 0
    assert sum(reading.dropped.values()) == 2


def test_a_world_that_says_z_down_is_refused_unless_the_settings_say_so():
    down = message(("quad", 2, (1.0, 2.0, 3.0), LEVEL), parent="mocap_ned")
    with pytest.raises(SampleError, match="sample 0: the frame `mocap_ned` says north-east-down"):
        unpacker().unpack(down)
    np.testing.assert_array_equal(unpacker("frd-ned").unpack(down).position, [[1.0, 2.0, 3.0]])
