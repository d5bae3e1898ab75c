# SPDX-FileCopyrightText: 2026 The quadpi authors
# SPDX-License-Identifier: Apache-2.0
"""RotorPy's model with the parameters of the file, of many samples: the simulation that lacks something.

`independent.nominal:rp_hummingbird` and `independent.nominal:rp_crazyflie` are the functions that
`quadpi discrepancy` is given.
"""

from __future__ import annotations

from typing import Any

import numpy as np

from independent.airframes import Airframe, Array, airframes

_FLIP = np.array([1.0, -1.0, -1.0])


def nominal_wrench(airframe: Airframe, airspeed: Array, rates: Array, speeds: Array) -> Array:
    """Wrench (N, 6) of airspeed, rates (N, 3) and rotor speeds (N, 4), all forward-left-up."""
    p, rotors = airframe.parameters, airframe.rotors
    hub = airspeed[:, None] + np.cross(rates[:, None], rotors[None])
    forces = -speeds[:, :, None] * hub * np.array([p["k_d"], p["k_d"], p["k_z"]])
    forces[:, :, 2] += p["k_eta"] * speeds**2 + p["k_h"] * (hub[:, :, 0] ** 2 + hub[:, :, 1] ** 2)
    drag = -np.linalg.norm(airspeed, axis=1)[:, None] * airspeed * [p["c_Dx"], p["c_Dy"], p["c_Dz"]]
    wrench = np.empty((len(speeds), 6))
    wrench[:, :3] = forces.sum(axis=1) + drag
    wrench[:, 3:] = np.cross(rotors[None], forces).sum(axis=1)
    wrench[:, 5] += p["k_m"] * speeds**2 @ p["rotor_directions"]
    return wrench


def _of_flight(airframe: Airframe, flight: Any) -> Array:
    """The same of a flight of quadpi, forward-right-down."""
    from quadpi_core.inputs import relative_to_air

    airspeed = relative_to_air(flight.velocity, flight.attitude, flight.wind) * _FLIP
    wrench = nominal_wrench(airframe, airspeed, flight.rates * _FLIP, flight.rotor_speeds)
    turned: Array = wrench * np.concatenate((_FLIP, _FLIP))
    return turned


def rp_hummingbird(flight: Any) -> Array:
    """RotorPy's Hummingbird."""
    return _of_flight(airframes()[0], flight)


def rp_crazyflie(flight: Any) -> Array:
    """RotorPy's brushless Crazyflie."""
    return _of_flight(airframes()[1], flight)
