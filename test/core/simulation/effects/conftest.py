# SPDX-FileCopyrightText: 2026 The quadpi authors
# SPDX-License-Identifier: Apache-2.0
"""A vehicle with its rotors above the centre of gravity; states of it, random and where formulas break."""

from __future__ import annotations

from dataclasses import replace
from itertools import product

import numpy as np
import pytest

from quadpi_core.simulation.rotor_local import RotorLocalModel


@pytest.fixture(scope="session")
def model():
    model = RotorLocalModel.load("bebop2")
    above = model.vehicle.rotor_positions + np.array([0.0, 0.0, -0.03])
    return replace(model, vehicle=replace(model.vehicle, rotor_positions=above))


@pytest.fixture(scope="session")
def record(model):
    return model.record()


@pytest.fixture(scope="session")
def states(model, random_states):
    return random_states(model, 300, seed=1)


@pytest.fixture(scope="session")
def degenerate_states(model):
    """Nothing moves, rotors stand, ground and ceiling touched or passed, straight climb and descent."""
    heights = (0.0, 1e-9, -0.1, -3.0, 0.01875, 0.1, 4.0, 1e4)
    speeds = (
        (0.0,) * 3,
        (0.0, 0.0, 5.0),
        (0.0, 0.0, -5.0),
        (1e-300, 0.0, 0.0),
        (30.0, 0.0, 0.0),
        (0.0, 1e3, 1e3),
    )
    rotors = ((0.0,) * 4, (700.0,) * 4, (0.0, 0.0, 700.0, 1200.0))
    rows = list(product(heights, speeds, rotors, (0.0, 40.0)))
    return model.states(
        np.array([speed for _, speed, _, _ in rows]),
        np.array([[rate] * 3 for *_, rate in rows]),
        np.array([rotor for _, _, rotor, _ in rows]),
        position=np.array([[0.0, 0.0, -height] for height, *_ in rows]),
    )


@pytest.fixture(scope="session")
def hover(model):
    """One level state at a height, with rotors at hover speed; call with what differs."""

    def build(velocity=(0.0, 0.0, 0.0), rates=(0.0, 0.0, 0.0), height=3.0, **rest):
        speeds = np.full((1, 4), model.hover_rotor_speed)
        position = np.array([[0.0, 0.0, -height]])
        rest = {name: np.array([values], dtype=float) for name, values in rest.items()}
        return model.states(
            np.array([velocity], dtype=float),
            np.array([rates], dtype=float),
            speeds,
            position=position,
            **rest,
        )

    return build
