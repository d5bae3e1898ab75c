# SPDX-FileCopyrightText: 2026 The quadpi authors
# SPDX-License-Identifier: Apache-2.0
from __future__ import annotations

import json
from dataclasses import replace

import numpy as np
import pytest

from quadpi_core.errors import ModelError
from quadpi_core.models.ensembles.network import Networks, Scaling


@pytest.fixture
def networks() -> Networks:
    """Two networks of two inputs, three units and one output."""
    rng = np.random.default_rng(1)
    return Networks(
        rng.normal(size=(2, 3, 2)),
        rng.normal(size=(2, 3)),
        rng.normal(size=(2, 1, 3)),
        rng.normal(size=(2, 1)),
    )


def test_a_network_worked_out_by_hand() -> None:
    networks = Networks(
        hidden_weights=np.array([[[1.0, 0.0], [0.0, -2.0], [1.0, 1.0]]]),
        hidden_biases=np.array([[0.0, 1.0, -10.0]]),
        output_weights=np.array([[[3.0, 5.0, 7.0]]]),
        output_biases=np.array([[0.5]]),
    )
    inputs = np.array([[2.0, 0.0], [-1.0, 1.0], [6.0, 6.0]])
    # Units: (2, 1, 0), (0, 0, 0), (6, 0, 2).
    np.testing.assert_array_equal(networks.outputs(inputs)[0, :, 0], [11.5, 0.5, 32.5])


def test_outputs_of_one_network_do_not_depend_on_the_others(networks: Networks) -> None:
    inputs = np.random.default_rng(2).normal(size=(5, 2))
    np.testing.assert_allclose(networks[1:].outputs(inputs)[0], networks.outputs(inputs)[1], rtol=1e-14)
    assert len(networks[1:]) == 1


def test_arrays_round_trip(networks: Networks) -> None:
    again = Networks.stored(networks.arrays("members"), "members")
    for name in ("hidden_weights", "hidden_biases", "output_weights", "output_biases"):
        np.testing.assert_array_equal(getattr(again, name), getattr(networks, name))


@pytest.mark.parametrize(
    ("name", "shape"),
    [
        ("hidden_weights", (2, 4, 2)),
        ("hidden_weights", (3, 3, 2)),
        ("hidden_weights", (6, 2)),
        ("hidden_biases", (2, 2)),
        ("hidden_biases", (6,)),
        ("output_weights", (2, 2, 3)),
        ("output_weights", (2, 3)),
        ("output_biases", (1, 1)),
        ("output_biases", ()),
    ],
)
def test_arrays_that_do_not_fit_together_are_refused(
    networks: Networks, name: str, shape: tuple[int, ...]
) -> None:
    arrays = networks.arrays("members") | {f"members.{name}": np.zeros(shape)}
    with pytest.raises(ModelError):
        Networks.stored(arrays, "members")


@pytest.mark.parametrize("shape", [(0, 3, 2), (2, 0, 2), (2, 3, 0)])
def test_networks_of_nothing_are_refused(shape: tuple[int, int, int]) -> None:
    members, units, inputs = shape
    empty = Networks(
        np.zeros((members, units, inputs)),
        np.zeros((members, units)),
        np.zeros((members, 1, units)),
        np.zeros((members, 1)),
    )
    with pytest.raises(ModelError, match="networks of shapes"):
        Networks.stored(empty.arrays("members"), "members")


def test_standardised_samples_have_mean_zero_and_unit_scale() -> None:
    rng = np.random.default_rng(3)
    inputs = rng.normal([3.0, -7.0, 2.0], [0.5, 4.0, 0.0], size=(1000, 3))
    scaling = Scaling.of(inputs, rng.normal(size=1000))
    standardised = scaling.standardised(inputs)
    np.testing.assert_allclose(standardised.mean(axis=0), 0.0, atol=1e-12)
    np.testing.assert_allclose(standardised.std(axis=0), [1.0, 1.0, 0.0], atol=1e-12)
    assert scaling.input_scale[2] == 1.0


def test_constant_target_is_refused() -> None:
    with pytest.raises(ModelError, match="constant"):
        Scaling.of(np.zeros((10, 2)), np.full(10, 3.0))


def test_scaling_round_trip() -> None:
    scaling = Scaling(np.array([1.0, 0.1]), np.array([2.0, 1e-9]), -1.0, 0.3)
    again = Scaling.from_json(json.loads(json.dumps(scaling.to_json())), 2)
    np.testing.assert_array_equal(again.input_mean, scaling.input_mean)
    np.testing.assert_array_equal(again.input_scale, scaling.input_scale)
    assert (again.target_mean, again.target_scale) == (-1.0, 0.3)


@pytest.mark.parametrize(
    "changes",
    [
        {"input_mean": [0.0]},
        {"input_scale": [1.0, 0.0]},
        {"input_scale": [1.0, -1.0]},
        {"input_scale": [1.0, float("inf")]},
        {"input_mean": [0.0, float("inf")]},
        {"target_scale": 0.0},
        {"target_scale": float("inf")},
        {"target_mean": float("nan")},
    ],
)
def test_scaling_that_no_samples_give_is_refused(changes: dict[str, object]) -> None:
    data = Scaling(np.zeros(2), np.ones(2), 0.0, 1.0).to_json()
    with pytest.raises(ModelError):
        Scaling.from_json(data | changes, 2)


def test_turned_arrays_are_stored_in_order(networks: Networks) -> None:
    turned = replace(networks, output_weights=networks.output_weights[:, :, ::-1])
    assert turned.arrays("members")["members.output_weights"].flags.c_contiguous


def test_single_precision_is_read_as_double(networks: Networks) -> None:
    arrays = {name: values.astype(np.float32) for name, values in networks.arrays("members").items()}
    assert Networks.stored(arrays, "members").hidden_weights.dtype == np.float64
