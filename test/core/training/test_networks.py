# SPDX-FileCopyrightText: 2026 The quadpi authors
# SPDX-License-Identifier: Apache-2.0
"""Networks in numpy: what they compute, how they are stored, and what is refused."""

from __future__ import annotations

import numpy as np
import pytest

from quadpi_core.errors import ModelError
from quadpi_core.training.networks import Networks


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


def test_arrays_round_trip(networks: Networks) -> None:
    again = Networks.stored(vars(networks))
    for name in ("hidden_weights", "hidden_biases", "output_weights", "output_biases"):
        np.testing.assert_array_equal(getattr(again, name), getattr(networks, name))


@pytest.mark.parametrize(
    ("name", "shape"),
    [
        ("hidden_weights", (2, 4, 2)),
        ("hidden_weights", (6, 2)),
        ("hidden_biases", (2, 2)),
        ("output_weights", (2, 2, 3)),
        ("output_biases", (1, 1)),
        ("output_biases", ()),
    ],
)
def test_arrays_that_do_not_fit_together_are_refused(
    networks: Networks, name: str, shape: tuple[int, ...]
) -> None:
    with pytest.raises(ModelError):
        Networks.stored(vars(networks) | {name: np.zeros(shape)})


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
        Networks.stored(vars(empty))


def test_single_precision_is_read_as_double(networks: Networks) -> None:
    arrays = {name: values.astype(np.float32) for name, values in vars(networks).items()}
    assert Networks.stored(arrays).hidden_weights.dtype == np.float64
