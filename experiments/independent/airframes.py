# SPDX-FileCopyrightText: 2026 The quadpi authors
# SPDX-License-Identifier: Apache-2.0
"""The two vehicles of the independent benchmark, with RotorPy's published parameters.

Everything here is in RotorPy's axes: body forward-left-up, world with z up.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from functools import lru_cache
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt

Array = npt.NDArray[np.float64]

HERE = Path(__file__).parent
GRAVITY_M_S2 = 9.81
AIR_DENSITY_KG_M3 = 1.225
# Lift slope times solidity of small propellers: two blades, mean chord an eighth of the radius, 5.5 per rad.
_SOLIDITY_SLOPE = 0.44


@dataclass(frozen=True)
class Airframe:
    """A vehicle and how well its sensors measure.

    Attributes:
        name: of its vehicle file.
        parameters: of RotorPy, with gains with which its controller is well damped at the rate of the log.
        radius_m: of the rotors; RotorPy gives none for the small one.
        speed_m_s, climb_m_s: largest of its flights.
        lowest_m: height of its flights near the ground.
        gyro_rad_s, accelerometer_m_s2, rotor_speed_rad_s: noise of a sample.
        mocap_m, mocap_rad: noise of a pose.
    """

    name: str
    parameters: dict[str, Any]
    radius_m: float
    speed_m_s: float
    climb_m_s: float
    lowest_m: float
    gyro_rad_s: float
    accelerometer_m_s2: float
    rotor_speed_rad_s: float
    mocap_m: float
    mocap_rad: float

    @property
    def file(self) -> Path:
        """The vehicle file that its owner has."""
        return HERE / "vehicles" / f"{self.name}.yaml"

    @property
    def mass_kg(self) -> float:
        return float(self.parameters["mass"])

    @property
    def weight_n(self) -> float:
        return self.mass_kg * GRAVITY_M_S2

    @property
    def inertia(self) -> Array:
        p = self.parameters
        return np.diag([p["Ixx"], p["Iyy"], p["Izz"]])

    @property
    def rotors(self) -> Array:
        """Positions (4, 3) m of the rotors."""
        return np.array(list(self.parameters["rotor_pos"].values()))

    @property
    def arm_m(self) -> float:
        return float(np.linalg.norm(self.rotors[:, :2], axis=1).mean())

    @property
    def hover_rad_s(self) -> float:
        return float(np.sqrt(self.weight_n / (4.0 * self.parameters["k_eta"])))

    @property
    def hover_inflow_m_s(self) -> float:
        """Induced velocity in hover, of momentum theory."""
        disc = np.pi * self.radius_m**2
        return float(np.sqrt(self.weight_n / (8.0 * AIR_DENSITY_KG_M3 * disc)))


@dataclass(frozen=True)
class Blades:
    """Blade elements of a rotor that gives the thrust k_eta ω² in hover; everything over tip speed.

    Attributes:
        slope: lift slope times solidity.
        pitch: of the blades, rad.
        inflow: induced in hover.
    """

    slope: float
    pitch: float
    inflow: float

    @classmethod
    def of(cls, airframe: Airframe) -> Blades:
        area = np.pi * airframe.radius_m**2
        thrust = airframe.parameters["k_eta"] / (AIR_DENSITY_KG_M3 * area * airframe.radius_m**2)
        inflow = float(np.sqrt(0.5 * thrust))
        return cls(_SOLIDITY_SLOPE, 3.0 * (2.0 * thrust / _SOLIDITY_SLOPE + 0.5 * inflow), inflow)

    @property
    def hover_thrust(self) -> float:
        return 2.0 * self.inflow**2

    def state(self, advance: Array, climb: Array) -> tuple[Array, Array]:
        """Thrust coefficient and total inflow in edgewise advance and climb, each over tip speed.

        Uniform induced velocity of Glauert, thrust of blade elements with constant pitch: Leishman,
            Principles
        of Helicopter Aerodynamics (2006), sections 2.14 and 3.3.
        """
        return _blade_state(self.slope, self.pitch, self.inflow, advance, climb)


def _blade_state(
    slope: float, pitch: float, hover: float, advance: Array, climb: Array
) -> tuple[Array, Array]:
    thrusts, inflows = np.empty_like(climb), np.empty_like(climb)
    for rotor, (across, along) in enumerate(zip(advance.tolist(), climb.tolist(), strict=True)):
        induced = hover
        thrust = 0.0
        for _ in range(12):
            inflow = induced + along
            thrust = 0.5 * slope * (pitch / 3.0 * (1.0 + 1.5 * across * across) - 0.5 * inflow)
            flow = math.sqrt(across * across + inflow * inflow)
            # Damped: the two halves of the step converge from hover to all speeds that are flown.
            induced = 0.5 * induced + 0.25 * thrust / max(flow, 0.25 * hover)
        thrusts[rotor], inflows[rotor] = thrust, induced + along
    return thrusts, inflows


@lru_cache
def airframes() -> tuple[Airframe, Airframe]:
    """A vehicle of half a kilogram and one of 44 g."""
    from rotorpy.vehicles.crazyfliebrushless_params import quad_params as small
    from rotorpy.vehicles.hummingbird_params import quad_params as large

    return (
        Airframe(
            name="rp_hummingbird",
            # Motors of this size take 20 ms; with RotorPy's 5 ms a step of the log would not resolve them.
            parameters={**large, "kp_att": 120.0, "kd_att": 20.0, "tau_m": 0.02},
            radius_m=float(large["rotor_radius"]),
            speed_m_s=6.0,
            climb_m_s=3.5,
            lowest_m=0.12,
            gyro_rad_s=0.01,
            accelerometer_m_s2=0.05,
            rotor_speed_rad_s=2.0,
            mocap_m=0.001,
            mocap_rad=0.005,
        ),
        Airframe(
            name="rp_crazyflie",
            parameters={**small, "kp_att": 250.0, "kd_att": 28.0},
            radius_m=0.0275,
            speed_m_s=4.0,
            climb_m_s=2.0,
            lowest_m=0.05,
            gyro_rad_s=0.02,
            accelerometer_m_s2=0.1,
            rotor_speed_rad_s=8.0,
            mocap_m=0.0005,
            mocap_rad=0.01,
        ),
    )
