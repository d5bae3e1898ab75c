# SPDX-FileCopyrightText: 2026 The quadpi authors
# SPDX-License-Identifier: Apache-2.0
"""A flight without the white noise of its states and rotor speeds, as columns of a regression need it.

The residual is the measured wrench less the simulated one, so it holds the noise of the simulation's inputs.
A column that is made of the same inputs, such as the tolerance of the thrust, holds the same noise: least
squares then shrink the simulation to remove it, by a quarter where the noise of the rotor speeds is most of
that of a moment (errors in variables; Fuller, Measurement Error Models, 1987). In a column that the residual
does not share, noise shrinks the effect. So columns are made of signals that Wiener's filter has freed of it;
the residual is not.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from scipy.ndimage import uniform_filter1d

from quadpi_core.flight import Flight
from quadpi_core.frames import Array
from quadpi_core.rotations import rotate_body_to_world, rotate_world_to_body

# Between these frequencies [Hz] a vehicle moves less than its sensors make noise: the upper half of what is
# compared. What does move there counts as noise too, and costs a column no more than these frequencies.
_NOISE_HZ = (12.0, 20.0)
# Width over which the power of a signal is averaged.
_AVERAGE_HZ = 0.6


def quiet(flight: Flight) -> Flight:
    """The flight with velocity, rates and rotor speeds without what looks like white noise of a channel."""
    rate = flight.rate_hz
    if 2.0 * _NOISE_HZ[1] > rate:
        return flight
    # In the world, an error of the attitude is not one of the velocity.
    velocity = _without_noise(rotate_body_to_world(flight.attitude, flight.velocity), rate)
    return replace(
        flight,
        velocity=rotate_world_to_body(flight.attitude, velocity),
        rates=_without_noise(flight.rates, rate),
        rotor_speeds=_without_noise(flight.rotor_speeds, rate),
    )


def _without_noise(values: Array, rate_hz: float) -> Array:
    """Wiener's filter of each column (N, C): each frequency's share of power above the noise."""
    samples = len(values)
    # Mirrored about both ends, so that the last sample leads on to the first.
    whole = np.concatenate((values, values[::-1]))
    spectrum = np.fft.rfft(whole, axis=0)
    frequency = np.fft.rfftfreq(len(whole), 1.0 / rate_hz)
    power = np.abs(spectrum) ** 2
    noise = power[(frequency >= _NOISE_HZ[0]) & (frequency < _NOISE_HZ[1])].mean(axis=0)
    width = max(1, round(_AVERAGE_HZ / frequency[1]))
    power = uniform_filter1d(power, width, axis=0)
    gain = np.where(
        power > noise, 1.0 - noise / np.maximum(power, np.maximum(noise, np.finfo(float).tiny)), 0.0
    )
    gain[frequency >= _NOISE_HZ[1]] = 0.0
    gain[0] = 1.0
    without: Array = np.fft.irfft(gain * spectrum, len(whole), axis=0)[:samples]
    return without
