# SPDX-FileCopyrightText: 2026 The quadpi authors
# SPDX-License-Identifier: Apache-2.0
from __future__ import annotations

import numpy as np

from quadpi_core.models.physical_fit import delayed, motions
from test.core.models.physical_flights import VEHICLE, derivatives_of, inputs_of, swept


def test_motion_follows_from_input_vector_and_derivatives() -> None:
    flight = swept(1.0, 0)
    motion = motions(inputs_of(flight), derivatives_of(flight), VEHICLE)
    for name in motion.dtype.names:
        np.testing.assert_allclose(motion[name], flight.motion[name], rtol=1e-9, atol=1e-9, err_msg=name)


def test_the_series_of_a_delay_is_right_to_its_third_order() -> None:
    time, delay_s = np.linspace(0.0, 1.0, 200), 0.01
    for frequency_hz, worst in ((2.0, 5e-4), (5.0, 6e-3)):
        omega = 2.0 * np.pi * frequency_hz
        speed, acceleration = delayed(
            np.sin(omega * time), omega * np.cos(omega * time), -(omega**2) * np.sin(omega * time), delay_s
        )
        assert np.abs(speed - np.sin(omega * (time - delay_s))).max() < worst
        error = acceleration / omega - np.cos(omega * (time - delay_s))
        assert np.abs(error).max() < (omega * delay_s) ** 2
