# SPDX-FileCopyrightText: 2026 The quadpi authors
# SPDX-License-Identifier: Apache-2.0
"""Forces and moments on the body as a whole."""

from __future__ import annotations

import numpy as np


def test_drag_is_along_the_airspeed_with_its_square_and_cube(states, added):
    velocity = states["velocity_air"]
    airspeed = np.linalg.norm(velocity, axis=1, keepdims=True)
    alike = added("body_drag", states, x_n_s2_m2=0.002, y_n_s2_m2=0.002, z_n_s2_m2=0.002)
    np.testing.assert_allclose(alike[:, :3], -0.002 * airspeed * velocity, rtol=1e-12)
    steeper = added("cubic_drag", states, drag_n_s3_m3=1e-4)
    np.testing.assert_allclose(steeper[:, :2], -1e-4 * airspeed**2 * velocity[:, :2], rtol=1e-12)
    for wrench in (alike, steeper):
        assert not wrench[:, 3:].any()


def test_each_axis_of_drag_and_damping_has_its_coefficient(states, added):
    drag = {"x_n_s2_m2": 0.001, "y_n_s2_m2": 0.002, "z_n_s2_m2": 0.003}
    force = added("body_drag", states, **drag)[:, :3]
    alike = added("body_drag", states, **dict.fromkeys(drag, 0.001))[:, :3]
    np.testing.assert_allclose(force, alike * [1.0, 2.0, 3.0], rtol=1e-12)
    moment = added("rate_damping", states, x_nm_s=1e-3, y_nm_s=2e-3, z_nm_s=3e-3)[:, 3:]
    np.testing.assert_allclose(moment, -1e-3 * states["rates"] * [1.0, 2.0, 3.0], rtol=1e-12)


def test_biases_are_the_same_in_every_state(states, added):
    force = added("force_bias", states, x_n=0.1, y_n=-0.2, z_n=0.3)
    np.testing.assert_array_equal(force, np.tile([0.1, -0.2, 0.3, 0.0, 0.0, 0.0], (len(states), 1)))
    moment = added("moment_bias", states, x_nm=0.01, y_nm=-0.02, z_nm=0.03)
    np.testing.assert_array_equal(moment, np.tile([0.0, 0.0, 0.0, 0.01, -0.02, 0.03], (len(states), 1)))


def test_tether_pulls_to_its_anchor_and_never_pushes(hover, added):
    slack = added("tether", hover(height=1.9))
    assert np.all(slack == 0.0)
    # Nose east, anchor north and up: to the left and up.
    east = np.array([np.sqrt(0.5), 0.0, 0.0, np.sqrt(0.5)])
    pull = added("tether", hover(height=3.0, attitude=east), north_m=4.0, height_m=6.0)
    force = 0.6 * (5.0 - 2.0) * np.array([0.0, -0.8, -0.6])
    np.testing.assert_allclose(pull[0, :3], force, atol=1e-12)
    # At the hook, a centimetre below the centre.
    np.testing.assert_allclose(pull[0, 3:], np.cross([0.0, 0.0, 0.01], force), atol=1e-12)


def test_offset_centre_feels_every_force(states, added):
    offset = {"x_m": 0.003, "y_m": -0.004, "z_m": 0.01}
    moment = added("cg_offset", states, **offset)[:, 3:]
    np.testing.assert_allclose(moment, -np.cross(list(offset.values()), states["wrench"][:, :3]), atol=1e-15)
