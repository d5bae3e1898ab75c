# SPDX-FileCopyrightText: 2026 The quadpi authors
# SPDX-License-Identifier: Apache-2.0
"""Effects of the sensors: errors of mounting, scale, bias and stamps, in the order of the signal."""

from __future__ import annotations

from dataclasses import replace
from typing import TypeVar

import numpy as np

from quadpi_core.core import cosine, sine
from quadpi_core.flight import Recording, Stamps, Stream
from quadpi_core.frames import Array, matrix
from quadpi_core.records import ROTORS_MAX
from quadpi_core.simulation.effect_definition import STRENGTH_OF_ONE_ROTOR, Parameter, effect, three
from quadpi_core.vehicle import Vehicle

_Late = TypeVar("_Late", bound=Stream)


def _inverse_scale(p: Array) -> Array:
    """Parameters of :func:`rotor_speed_scale` that invert the factor 1 + k."""
    return np.array([p[0], -p[1] / (1.0 + p[1])])


@effect(
    "sensor",
    "Fx Fy Fz",
    *three("m", "m", 0.01, 0.2),
    # An offset of the centre of gravity is one of the accelerometer relative to it, too.
    tolerance="cg_m",
    formula=r"f' = f + \dot\Omega \times r + \Omega \times (\Omega \times r),\quad r = (r_x, r_y, r_z)",
    symbols="r_x r_y r_z",
)
def imu_lever_arm(recording: Recording, vehicle: Vehicle, p: Array) -> Recording:  # noqa: ARG001
    """The IMU sits away from the centre of gravity.

    The angular acceleration is the central difference of the recorded rates. Size: 2 cm.
    """
    imu = recording.imu
    shifted = _at_lever_arm(imu.time_ns, imu.angular_velocity, imu.specific_force, p)
    return replace(recording, imu=replace(imu, specific_force=shifted))


@effect(
    "sensor",
    "Fx Fy Fz Mx My Mz",
    *three("deg", "deg", 1.2, 45.0),
    shown_by="vertical accelerations and throttle steps",
    formula=(
        r"f' = R(\delta)^T f,\quad "
        r"\Omega' = R(\delta)^T \Omega,\quad "
        r"\delta = (\delta_x, \delta_y, \delta_z)"
    ),
    symbols=r"\delta_x \delta_y \delta_z",
    of_a_flight="the IMU or the markers turned",
)
def imu_misalignment(recording: Recording, vehicle: Vehicle, p: Array) -> Recording:  # noqa: ARG001
    """The IMU is turned in the body: accelerometer and gyro alike.

    R is the rotation by the vector δ from its axes to the body's. Size: 2° together.
    """
    imu = recording.imu
    rates, force = (_in_turned_axes(own, p) for own in (imu.angular_velocity, imu.specific_force))
    return replace(recording, imu=replace(imu, angular_velocity=rates, specific_force=force))


@effect(
    "sensor",
    "Fx Fy Fz",
    *(Parameter(f"{axis}_change", "", 0.02, -0.5, 1.0) for axis in "xyz"),
    formula=r"f'_j = (1 + k_j)\,f_j,\quad k = (k_x, k_y, k_z)",
    symbols="k_x k_y k_z",
)
def accelerometer_scale(recording: Recording, vehicle: Vehicle, p: Array) -> Recording:  # noqa: ARG001
    """Scale of the accelerometer.

    Size: 2 %.
    """
    imu = recording.imu
    return replace(recording, imu=replace(imu, specific_force=imu.specific_force * (1.0 + p)))


@effect(
    "sensor",
    "Fx Fy Fz",
    *three("m_s2", "m/s²", 0.2, 10.0),
    formula=r"f' = f + (b_x,\ b_y,\ b_z)",
    symbols="b_x b_y b_z",
)
def accelerometer_bias(recording: Recording, vehicle: Vehicle, p: Array) -> Recording:  # noqa: ARG001
    """Bias of the accelerometer.

    Size: 0.2 m/s².
    """
    imu = recording.imu
    return replace(recording, imu=replace(imu, specific_force=imu.specific_force + p))


@effect(
    "sensor",
    "Fx Fy Fz Mx My Mz",
    *three("rad_s", "rad/s", 0.02, 1.0),
    formula=r"\Omega' = \Omega + (b_x,\ b_y,\ b_z)",
    symbols="b_x b_y b_z",
)
def gyro_bias(recording: Recording, vehicle: Vehicle, p: Array) -> Recording:  # noqa: ARG001
    """Bias of the gyro.

    Size: 1 °/s.
    """
    imu = recording.imu
    return replace(recording, imu=replace(imu, angular_velocity=imu.angular_velocity + p))


@effect(
    "sensor",
    "Fx Fy Fz Mx My Mz",
    Parameter("rotor", "", 0.0, 0.0, float(ROTORS_MAX), whole=True),
    Parameter("change", "", 0.02, -0.9, 1.0),
    shown_by="weighing the thrust of each rotor; throttle steps with yaw",
    inverse=_inverse_scale,
    indistinguishable_group=STRENGTH_OF_ONE_ROTOR,
    scales_thrust=True,
    formula=r"\omega'_j = (1 + k)\,\omega_j,\quad j = 0:\ \text{every rotor}",
    symbols="j k",
)
def rotor_speed_scale(recording: Recording, vehicle: Vehicle, p: Array) -> Recording:  # noqa: ARG001
    """Scale of the measured rotor speeds, of one rotor or (rotor 0) of all.

    k = −0.5 is a sensor that reads half, as real ones do. Size: 2 %.
    """
    stream = recording.rotor_speeds
    if stream is None:
        return recording
    scale = np.ones(stream.speeds.shape[1])
    scale[slice(None) if p[0] == 0 else int(p[0]) - 1] += p[1]
    return replace(recording, rotor_speeds=replace(stream, speeds=stream.speeds * scale))


@effect(
    "sensor",
    "Fx Fy Fz Mx My Mz",
    Parameter("rotor_speeds_s", "s", 0.01, 0.0, 0.5),
    Parameter("mocap_s", "s", 0.01, 0.0, 0.5),
    shown_by="fast doublets and angular chirps",
    formula=r"\omega'(t) = \omega(t - \tau_\omega),\quad x'(t) = x(t - \tau_x)",
    symbols=r"\tau_\omega \tau_x",
    of_a_flight="the clocks of a log",
    shifts_noise=True,
)
def sensor_delay(recording: Recording, vehicle: Vehicle, p: Array) -> Recording:  # noqa: ARG001
    """Rotor speeds and motion capture (or a fused state) are stamped late, relative to the IMU.

    Their stamps move later by the delays; no value changes. Size: 10 ms.
    """
    rotor_speeds_ns, mocap_ns = (round(1e9 * delay) for delay in p)
    return replace(
        recording,
        rotor_speeds=_stamped_later(recording.rotor_speeds, rotor_speeds_ns),
        pose=_stamped_later(recording.pose, mocap_ns),
        odometry=_stamped_later(recording.odometry, mocap_ns),
    )


def _stamped_later(stream: _Late | None, delay_ns: int) -> _Late | None:
    return None if stream is None else replace(stream, time_ns=stream.time_ns + delay_ns)


def _at_lever_arm(time_ns: Stamps, rates: Array, specific_force: Array, arm: Array) -> Array:
    rows = np.arange(len(rates))
    before, after = np.maximum(rows - 1, 0), np.minimum(rows + 1, len(rows) - 1)
    step = 1e-9 * np.maximum(time_ns[after] - time_ns[before], 1)
    x, y, z = arm
    p, q, r = rates.T
    dp, dq, dr = (rates[after] - rates[before]).T / step
    along = p * x + q * y + r * z
    square = p * p + q * q + r * r
    swept = (
        dq * z - dr * y + p * along - x * square,
        dr * x - dp * z + q * along - y * square,
        dp * y - dq * x + r * along - z * square,
    )
    return np.asarray(specific_force + np.stack(swept, axis=1))


def _in_turned_axes(vectors: Array, angles_deg: Array) -> Array:
    # By the half angle, as an exported effect has no compiled rotations.
    half_x, half_y, half_z = 0.5 * np.radians(angles_deg)
    half = np.sqrt(half_x * half_x + half_y * half_y + half_z * half_z)
    scale = sine(half) / half if half > 0.0 else 1.0
    rotation = matrix(np.array([cosine(half), scale * half_x, scale * half_y, scale * half_z]))
    x, y, z = vectors.T
    return np.stack([one * x + other * y + last * z for one, other, last in rotation.T], axis=1)
