# SPDX-FileCopyrightText: 2026 The quadpi authors
# SPDX-License-Identifier: Apache-2.0
from __future__ import annotations

from dataclasses import fields, replace

import numpy as np
import pytest

from quadpi_core.errors import ModelError
from quadpi_core.monitor.monitor import Monitor
from quadpi_core.monitor.pairing import PairedSamples
from quadpi_core.monitor.several_models import Monitors

RATE_HZ = 500.0


def assert_same(left, right):
    for field in fields(left):
        np.testing.assert_array_equal(getattr(left, field.name), getattr(right, field.name))


def cut(samples: PairedSamples, keep) -> PairedSamples:
    return PairedSamples(*(column[keep] for column in samples))


def test_each_model_says_what_it_says_alone(model, vehicle, samples):
    slower = replace(model, cutoff_hz=20.0)
    models = {"first": model, "same": model, "slower": slower}
    together = Monitors({name: Monitor(item, vehicle, RATE_HZ) for name, item in models.items()})
    (predictions, alarms, _), others = together.step(samples)
    alone = Monitor(model, vehicle, RATE_HZ).step(*samples)
    assert_same(predictions, alone[0])
    assert_same(alarms, alone[1])
    assert_same(others[0], alone[0])
    assert_same(others[1], Monitor(slower, vehicle, RATE_HZ).step(*samples)[0])


def test_models_of_one_cutoff_share_the_low_pass(model, vehicle):
    slower = replace(model, cutoff_hz=20.0)
    models = {"first": model, "slower": slower, "same": model}
    monitors = Monitors({name: Monitor(item, vehicle, RATE_HZ) for name, item in models.items()})
    assert monitors["first"].preparation is monitors["same"].preparation
    assert monitors["first"].preparation is not monitors["slower"].preparation


def test_the_low_pass_goes_on_when_a_model_is_replaced(model, vehicle, samples):
    half = len(samples.time_ns) // 2
    monitors = Monitors({"first": Monitor(model, vehicle, RATE_HZ)})
    monitors.step(cut(samples, slice(None, half)))
    monitors.replace("first", Monitor(model, vehicle, RATE_HZ))
    (predictions, _, _), _ = monitors.step(cut(samples, slice(half, None)))
    whole, *_ = Monitor(model, vehicle, RATE_HZ).step(*samples)
    np.testing.assert_array_equal(predictions.predicted, whole.predicted[-len(predictions.time_ns) :])
    assert monitors.names == ["first"]


def test_what_does_not_fly_cannot_be_replaced(model, vehicle):
    monitors = Monitors({"first": Monitor(model, vehicle, RATE_HZ)})
    with pytest.raises(ModelError, match="no model flies as `second`; those that fly: first"):
        monitors.replace("second", Monitor(model, vehicle, RATE_HZ))
