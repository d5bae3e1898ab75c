# SPDX-FileCopyrightText: 2026 The quadpi authors
# SPDX-License-Identifier: Apache-2.0
from __future__ import annotations

import numpy as np
import pytest

from quadpi_core.models.physical_terms import TERM_INDEX, TERM_NAMES, TERMS, scales
from quadpi_core.vehicle import Vehicle


def test_terms_have_names_of_their_own_and_spreads() -> None:
    assert len(set(TERM_NAMES)) == len(TERMS)
    assert all(term.spread > 0.0 for term in TERMS)
    assert all(term.mean >= 0.0 for term in TERMS if term.positive)


def test_scales_are_those_of_the_vehicle() -> None:
    vehicle, reference = Vehicle.load("neurobem"), 1.55e-6
    scale = dict(zip(TERM_NAMES, scales(vehicle, reference), strict=True))
    assert scale["thrust"] == reference
    assert scale["torque"] == pytest.approx(reference * vehicle.rotor_radius_m)
    assert scale["imu_x"] == vehicle.rotor_radius_m
    assert scale["bias_z"] == pytest.approx(vehicle.mass_kg * vehicle.gravity_m_s2)
    half_length, half_width = np.abs(vehicle.rotor_positions).mean(axis=0)[:2]
    area = 4.0 * half_length * half_width
    assert scale["drag_x"] == pytest.approx(0.5 * vehicle.air_density_kg_m3 * area)
    assert TERM_INDEX["thrust"] == 0
