# SPDX-FileCopyrightText: 2026 The quadpi authors
# SPDX-License-Identifier: Apache-2.0
"""What a monitor says of its models is what a page reads, and nothing else is read."""

from __future__ import annotations

import json
from dataclasses import replace

import numpy as np
import pytest

from quadpi_core.errors import LogError
from quadpi_core.inputs import INPUT_NAMES
from quadpi_core.messages.result_messages import DescribedModel, pack_description, unpack_description
from quadpi_core.vehicle import Vehicle

LOWER = -np.arange(1.0, len(INPUT_NAMES) + 1.0)
MODEL = DescribedModel('hover "1"@0123', "bebop2", LOWER, -2.0 * LOWER)


def test_it_is_read_as_it_was_written():
    other = DescribedModel("other@1", "neurobem", LOWER, LOWER)
    found = unpack_description(pack_description([MODEL, other], {"prediction": "/uav/prediction"}))
    assert list(found.models) == [MODEL.identity, "other@1"]
    assert found.models[MODEL.identity].vehicle == "bebop2"
    np.testing.assert_array_equal(found.models[MODEL.identity].lower, MODEL.lower)
    np.testing.assert_array_equal(found.models[MODEL.identity].upper, MODEL.upper)
    assert found.topics == {"prediction": "/uav/prediction"}


def test_what_inputs_are_computed_with_is_read_too():
    vehicle = Vehicle.load("neurobem")
    model = replace(MODEL, vehicle="neurobem", cutoff_hz=30.0)
    found = unpack_description(pack_description([model], {}, vehicle))
    assert found.models[model.identity].cutoff_hz == 30.0
    assert found.vehicle is not None
    assert (found.vehicle.name, found.vehicle.fingerprint) == ("neurobem", vehicle.fingerprint)
    assert found.vehicle.pole_pairs == vehicle.pole_pairs
    earlier = unpack_description(pack_description([MODEL], {}))
    assert earlier.vehicle is None
    assert earlier.models[MODEL.identity].cutoff_hz is None


def with_key(name: str, value: object) -> str:
    return json.dumps(json.loads(pack_description([MODEL], {})) | {name: value})


def changed(**training: object) -> str:
    given = json.loads(pack_description([MODEL], {}))
    given["models"][0]["training"] |= training
    return json.dumps(given)


@pytest.mark.parametrize(
    "text",
    [
        "",
        "[]",
        "{}",
        '{"models": 3, "topics": {}}',
        '{"models": [], "topics": []}',
        "[" * 100_000,
        with_key("vehicle", {"name": "quad", "file": {"mass_kg": -1.0}}),
        with_key("vehicle", 3),
        with_key("models", [json.loads(pack_description([MODEL], {}))["models"][0] | {"cutoff_hz": -1.0}]),
        changed(u=None),
        changed(u=[1.0]),
        changed(u=[float("nan"), 1.0]),
        changed(u=[10**400, 1.0]),
    ],
)
def test_another_text_is_refused(text):
    with pytest.raises(LogError, match="not the description of a monitor"):
        unpack_description(text)
