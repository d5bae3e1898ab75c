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
from quadpi_core.thresholds import CONVENTION, Threshold

NOISE_HZ = Threshold(
    "band of noise",
    (12.0, 20.0),
    "Hz",
    "the upper half of the frequencies compared, where a vehicle moves less than its sensors make noise",
    CONVENTION,
)
AVERAGE_HZ = Threshold(
    "width of the average of power",
    0.6,
    "Hz",
    "averages several frequencies of a flight of 10 s, and is narrower than the band of any manoeuvre",
    CONVENTION,
)


def quiet(flight: Flight) -> Flight:
    """The flight with the white noise of its velocity, rates and rotor speeds filtered out."""
    rate = flight.rate_hz
    if 2.0 * NOISE_HZ.value[1] > rate:
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
    noise = power[(frequency >= NOISE_HZ.value[0]) & (frequency < NOISE_HZ.value[1])].mean(axis=0)
    width = max(1, round(AVERAGE_HZ.value / frequency[1]))
    power = uniform_filter1d(power, width, axis=0)
    gain = np.where(
        power > noise, 1.0 - noise / np.maximum(power, np.maximum(noise, np.finfo(float).tiny)), 0.0
    )
    gain[frequency >= NOISE_HZ.value[1]] = 0.0
    gain[0] = 1.0
    without: Array = np.fft.irfft(gain * spectrum, len(whole), axis=0)[:samples]
    return without
