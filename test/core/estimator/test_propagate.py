# SPDX-FileCopyrightText: 2026 The quadpi authors
# SPDX-License-Identifier: Apache-2.0
"""The algebra of one estimate against dense matrices and finite differences."""

from __future__ import annotations

from itertools import pairwise

import numpy as np

from quadpi_core.estimator.filter_run import imu_records
from quadpi_core.estimator.filter_state import ESTIMATE, NOISE, TRANSITION
from quadpi_core.estimator.propagate import propagate_between
from quadpi_core.flight import ImuStream


def test_dead_reckoning_on_ideal_sensors_is_of_second_order(noisy_vehicle, true_flight):
    errors = []
    for rate in (100.0, 200.0):
        time = np.arange(0.0, 2.0 + 1e-9, 1.0 / rate)
        time_ns = np.rint(time * 1e9).astype(np.int64)
        true = true_flight(time)
        estimate, noise, transition = np.zeros(1, ESTIMATE), np.zeros(1, NOISE), np.zeros(1, TRANSITION)
        estimate["position"], estimate["velocity"] = true.position[0], true.velocity[0]
        estimate["attitude"], noise["gravity"] = true.attitude[0], noisy_vehicle.gravity_m_s2
        samples = imu_records(ImuStream(time_ns, true.rates, true.specific_force))
        for first, second in pairwise(samples):
            propagate_between(estimate[0], noise[0], first, second, second["time_ns"], transition[0])
        errors.append(np.linalg.norm(estimate["velocity"][0] - true.velocity[-1]))
    assert errors[0] < 2e-3
    assert errors[1] < 0.3 * errors[0]
