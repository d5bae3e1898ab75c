# SPDX-FileCopyrightText: 2026 The quadpi authors
# SPDX-License-Identifier: Apache-2.0
"""What flights contain is told, and what they lack is asked for."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from quadpi_core.errors import DiscrepancyError
from quadpi_core.screening.rotors_in_flight import require_changes, require_excitation


def test_hover_alone_names_what_is_missing(flights, simulation):
    """The first instant of a flight, held, with the flicker of rotors."""
    rng = np.random.default_rng(0)
    still = []
    for flight in flights[:2]:
        none = np.zeros_like(flight.velocity)
        level = np.tile([1.0, 0.0, 0.0, 0.0], (len(flight), 1))
        flicker = rng.standard_normal(flight.rotor_speeds.shape)
        still.append(replace(flight, velocity=none, rates=none, attitude=level, rotor_speeds=600.0 + flicker))
    with pytest.raises(
        DiscrepancyError, match=r"nothing but hover, .*; fly forward and backward flight, sid"
    ):
        require_excitation(still, simulation.vehicle)


def test_what_was_flown_is_not_asked_for(flights, simulation):
    missing = require_excitation(flights, simulation.vehicle)
    assert not {"forward and backward flight", "sideways flight", "yaw doublets"} & set(missing)
    slow = [replace(flight, velocity=0.01 * flight.velocity) for flight in flights]
    assert {"forward and backward flight", "sideways flight", "climb and descent"} <= set(
        require_excitation(slow, simulation.vehicle)
    )


def test_rotor_speeds_that_do_not_change_are_refused_with_the_rotor(flights):
    speeds = flights[0].rotor_speeds.copy()
    speeds[:, 2] = 612.0
    require_changes(flights[0])
    with pytest.raises(
        DiscrepancyError, match=r": topic rotor_speeds: rotor 3 has the same speed .*, 612 rad"
    ):
        require_changes(replace(flights[0], rotor_speeds=speeds))
