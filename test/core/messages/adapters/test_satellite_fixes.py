# SPDX-FileCopyrightText: 2026 The quadpi authors
# SPDX-License-Identifier: Apache-2.0
"""Positions by satellites: metres from the first fix, their noise, and what is no fix."""

from __future__ import annotations

import numpy as np
import pytest

from quadpi_core.flight import NOT_MEASURED
from quadpi_core.frames import Array
from quadpi_core.messages.adapters.packages.satellite_fixes import local_position

from .test_adapter_registry import opened
from .vendor_messages import START_NS, satellite_fix


def earth_fixed(latitude: float, longitude: float, height: float) -> Array:
    """The position in axes of the earth, by the definition of the ellipsoid."""
    axis, flattening = 6378137.0, 1.0 / 298.257223563
    squared = flattening * (2.0 - flattening)
    phi, lam = np.deg2rad([latitude, longitude])
    radius = axis / np.sqrt(1.0 - squared * np.sin(phi) ** 2)
    around = (radius + height) * np.cos(phi)
    return np.array(
        [around * np.cos(lam), around * np.sin(lam), (radius * (1.0 - squared) + height) * np.sin(phi)]
    )


@pytest.mark.parametrize(
    "origin", [(47.4, 8.5, 480.0), (-33.9, 151.2, 20.0), (0.0, 179.9999, 0.0), (69.0, -20.0, 900.0)]
)
def test_positions_are_metres_from_the_first_fix(origin: tuple[float, float, float]) -> None:
    moved = np.add(origin, (0.0005, 0.0007, 12.0))
    turned = (moved[1] + 180.0) % 360.0 - 180.0
    found = local_position(moved[:1], np.array([turned]), moved[2:], np.array(origin))[0]
    phi, lam = np.deg2rad(origin[:2])
    to_ned = np.array(
        [
            [-np.sin(phi) * np.cos(lam), -np.sin(phi) * np.sin(lam), np.cos(phi)],
            [-np.sin(lam), np.cos(lam), 0.0],
            [-np.cos(phi) * np.cos(lam), -np.cos(phi) * np.sin(lam), -np.sin(phi)],
        ]
    )
    true = to_ned @ (earth_fixed(*moved) - earth_fixed(*origin))
    np.testing.assert_allclose(found, true, atol=2e-3)


def test_a_fix_says_its_noise_and_no_attitude(vendor) -> None:
    reading = opened(vendor.px4_1_14, "fix")
    first, second, unknown = (
        reading.unpack(satellite_fix(vendor.px4_1_14, START_NS + k, 47.0 + 1e-5 * k, 8.0, 500.0 + k, **more))
        for k, more in enumerate(({}, {"variance": 9.0}, {"kind": 0}))
    )
    np.testing.assert_array_equal(first.position, np.zeros((1, 3)))
    np.testing.assert_allclose(second.position, [[1.112, 0.0, -1.0]], atol=1e-3)
    assert first.deviation.tolist() == [[2.0, NOT_MEASURED, NOT_MEASURED]]
    assert (second.deviation[0, 0], unknown.deviation[0, 0]) == (3.0, 0.0)


def test_what_is_no_fix_is_dropped_and_is_no_origin(vendor) -> None:
    reading = opened(vendor.px4_1_14, "fix")
    assert len(reading.unpack(satellite_fix(vendor.px4_1_14, START_NS, 0.0, 0.0, 0.0, status=-1))) == 0
    assert len(reading.unpack(satellite_fix(vendor.px4_1_14, START_NS + 1, np.nan, 8.0, 0.0))) == 0
    assert reading.dropped == {"no fix": 2}
    at = reading.unpack(satellite_fix(vendor.px4_1_14, START_NS + 2, 47.0, 8.0, 500.0))
    np.testing.assert_array_equal(at.position, np.zeros((1, 3)))


@pytest.mark.parametrize(("latitude", "longitude"), [(0.0, 0.0), (91.0, 8.0), (47.0, 400.0)])
def test_no_place_is_no_origin(vendor, latitude, longitude):
    reading = opened(vendor.px4_1_14, "fix")
    first = satellite_fix(vendor.px4_1_14, START_NS, latitude, longitude, 0.0)
    assert len(reading.unpack(first)) == 0
    at = reading.unpack(satellite_fix(vendor.px4_1_14, START_NS + 1, 47.0, 8.0, 500.0))
    assert at.position.tolist() == [[0.0, 0.0, 0.0]]
    assert reading.dropped == {"no fix": 1}


@pytest.mark.parametrize("variance", [np.inf, 1e4])
def test_a_position_that_its_message_does_not_know_is_none(vendor, variance):
    reading = opened(vendor.px4_1_14, "fix")
    fix = satellite_fix(vendor.px4_1_14, START_NS, 47.0, 8.0, 500.0, variance=variance)
    assert len(reading.unpack(fix)) == 0
    assert reading.dropped == {"position is not known": 1}


def test_a_covariance_that_is_no_number_says_nothing(vendor):
    fix = satellite_fix(vendor.px4_1_14, START_NS, 47.0, 8.0, 500.0, variance=np.nan)
    assert opened(vendor.px4_1_14, "fix").unpack(fix).deviation[0, 0] == 0.0
