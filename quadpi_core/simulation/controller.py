# SPDX-FileCopyrightText: 2026 The quadpi authors
# SPDX-License-Identifier: Apache-2.0
"""Position and yaw controller: geometric, with incremental dynamic inversion of thrust and moments.

Position and attitude errors give a demanded specific force and angular acceleration (geometric tracking
control of Lee, Leok and McClamroch, 2010, with feed-forward of the rates of the reference). The wrench of the
last instant less the rotors' hover thrust and torque, mainly drag, is a disturbance that is assumed constant
until the next step (incremental nonlinear dynamic inversion, Smeur et al., 2016). The controller knows mass,
inertia and hover coefficients of the nominal vehicle, and the true state.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from quadpi_core.core import compiled
from quadpi_core.frames import Array
from quadpi_core.linear_algebra import pseudo_inverse
from quadpi_core.records import Records
from quadpi_core.thresholds import CONVENTION, Threshold

TILT_MAX_DEG = Threshold(
    "largest tilt of a path",
    compiled.TILT_MAX_DEG,
    "degrees",
    "a position error must not turn the vehicle over; excitation adds to it",
    CONVENTION,
)
SPECIFIC_FORCE_MIN = Threshold(
    "least upward specific force demanded",
    compiled.SPECIFIC_FORCE_MIN,
    "m/s²",
    "near zero the attitude of the thrust is undefined",
    CONVENTION,
)


class Demand(NamedTuple):
    """The reference, its jerk (N, 3) m/s³, and the wind (N, 3) m/s in the world, at every step."""

    position: Array
    velocity: Array
    acceleration: Array
    jerk: Array
    yaw: Array
    yaw_rate: Array
    tilt: Array
    thrust: Array
    wind: Array


class Controls(NamedTuple):
    """Parameters of the nominal vehicle, and memory of the controller.

    Attributes:
        nominal: record VEHICLE (1,).
        allocation: (rotors, 4) squares of the rotor speeds from thrust and moments.
        effectiveness: (4, rotors) whose inverse it is, of other numbers of rotors than four its
            pseudo-inverse.
        disturbance: (6,) wrench of the last instant less that of the rotors in hover.
        command: (rotors,) commanded rotor speeds [rad/s].
    """

    nominal: Records
    allocation: Array
    effectiveness: Array
    disturbance: Array
    command: Array

    @classmethod
    def of(cls, nominal: Records, effectiveness: Array) -> Controls:
        """For a nominal vehicle.

        Args:
            nominal: record VEHICLE (1,).
            effectiveness: (4, rotors) change of thrust and moments by the squared speed of each rotor, in
                hover.
        """
        hover, rotors = float(nominal[0]["hover_rotor_speed"]), effectiveness.shape[1]
        return cls(
            nominal=nominal,
            allocation=pseudo_inverse(effectiveness),
            effectiveness=effectiveness,
            disturbance=np.zeros(6),
            command=np.full(rotors, hover),
        )


def observe(controls: Controls, state: Records) -> None:
    """Update the disturbance: the wrench of a STATE (1,) less that of rotors in hover at its rotor speeds."""
    compiled.observe(controls, state)


def control(controls: Controls, motion: Records, demand: Demand, step: int) -> None:
    """Set the commanded rotor speeds for one step.

    Args:
        controls: see :class:`Controls`; its `command` is replaced.
        motion: record MOTION (1,) of the true state.
        demand: reference to follow.
        step: index of the instant.
    """
    compiled.control(controls, motion, demand, step)
