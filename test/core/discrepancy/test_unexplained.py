# SPDX-FileCopyrightText: 2026 The quadpi authors
# SPDX-License-Identifier: Apache-2.0
"""Functions that know no physics: points of the ground, where flights meet."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from quadpi_core.discrepancy.effect_response import Compared
from quadpi_core.discrepancy.unexplained import functions_of_place


def test_points_lie_where_flights_meet_however_far_others_are(simulation, flights):
    """The ground between is ten million points; none of them is asked for."""
    near = [Compared(flight, simulation) for flight in flights[:2]]
    far = Compared(replace(flights[0], position=flights[0].position + np.array([3e3, 3e3, 0])), simulation)
    names, values = functions_of_place(near)
    assert len(names) > 0
    further, spread = functions_of_place([*near, far])
    assert further == names
    for one, other in zip(values, spread, strict=False):
        np.testing.assert_array_equal(one, other)
    assert not spread[-1].any()


def test_shares_of_a_place_are_a_whole_at_most(simulation, flights):
    level = [replace(flight, attitude=np.tile([1.0, 0, 0, 0], (len(flight), 1))) for flight in flights]
    names, values = functions_of_place([Compared(flight, simulation) for flight in level])
    north = np.array(names) == "place north"
    for own in values:
        assert own[:, 0, north].sum(axis=1).max() <= 1.0 + 1e-12
        assert not own[:, 1, north].any()
