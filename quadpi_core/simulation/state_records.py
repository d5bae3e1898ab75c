# SPDX-FileCopyrightText: 2026 The quadpi authors
# SPDX-License-Identifier: Apache-2.0
"""Records that the compiled physics works on: the state at an instant, and the vehicle.

Body axes forward-right-down, world north-east-down with the ground at height 0, SI units. Rotors in the
order of the vehicle file. Kernels read `state.rates[2]` instead of an offset into a bare array.
"""

from __future__ import annotations

import numba
import numpy as np

STATE = np.dtype(
    [
        # Position [m] in the world and attitude (w, x, y, z) body to world.
        ("position", "f8", (3,)),
        ("attitude", "f8", (4,)),
        # Relative to the air [m/s], body axes.
        ("velocity_air", "f8", (3,)),
        # Body rates [rad/s].
        ("rates", "f8", (3,)),
        # Speed [rad/s] of each rotor and its derivative [rad/s²].
        ("rotor_speeds", "f8", (4,)),
        ("rotor_accelerations", "f8", (4,)),
        # Of each rotor: velocity [m/s] of its hub relative to the air, thrust [N] along -z, and torque [Nm]
        # on the body about z, of the aerodynamics alone.
        ("hub_velocity", "f8", (4, 3)),
        ("thrusts", "f8", (4,)),
        ("torques", "f8", (4,)),
        # Wrench [N, Nm] of the aerodynamics and of the effects applied so far.
        ("wrench", "f8", (6,)),
    ],
    align=True,
)

VEHICLE = np.dtype(
    [
        ("mass", "f8"),
        ("gravity", "f8"),
        ("air_density", "f8"),
        ("inertia", "f8", (3, 3)),
        ("inverse_inertia", "f8", (3, 3)),
        ("rotor_positions", "f8", (4, 3)),
        # +1 where the rotor turns clockwise seen from above.
        ("rotor_spins", "f8", (4,)),
        ("rotor_radius", "f8"),
        # Hover of the vehicle as in its file: induced velocity [m/s] and rotor speed [rad/s].
        ("hover_induced_velocity", "f8"),
        ("hover_rotor_speed", "f8"),
        ("motor_time_constant", "f8"),
        ("rotor_speed_max", "f8"),
        # Rotor-local aerodynamics; see `rotor_local`.
        ("thrust", "f8", (16,)),
        ("torque", "f8", (16,)),
        ("rotor_force_along", "f8"),
        ("rotor_force_across", "f8"),
        ("rotor_moment_along", "f8"),
        ("rotor_moment_across", "f8"),
        ("airframe_area", "f8"),
        ("airframe_fx", "f8", (2,)),
        ("airframe_fy", "f8", (2,)),
        ("airframe_fz", "f8", (2,)),
        ("airframe_mx", "f8", (6,)),
        ("airframe_my", "f8", (6,)),
        ("airframe_mz", "f8", (6,)),
    ],
    align=True,
)

STATE_TYPE = numba.from_dtype(STATE)
VEHICLE_TYPE = numba.from_dtype(VEHICLE)
