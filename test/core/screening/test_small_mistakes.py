# SPDX-FileCopyrightText: 2026 The quadpi authors
# SPDX-License-Identifier: Apache-2.0
"""Origin and scale are measured as they are, and calm flights do not tell them."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from quadpi_core.screening.excerpt import innovation
from quadpi_core.screening.motion_consistency import motion_fit, small_mistakes


def moved(sample, place_m):
    """What motion capture of another origin sees."""
    turned = Rotation.from_quat(sample.attitude[0], scalar_first=True).apply(place_m)
    return replace(sample, position=sample.position + turned)


def named(sample, measured=True):
    return [one.name for one in small_mistakes(sample, innovation(sample), measured=measured)]


@pytest.mark.parametrize("place_m", [(0.0, 0.0, 0.0), (0.1, 0.0, -0.02), (0.0, -0.06, 0.08)])
def test_the_origin_is_measured_to_a_centimetre(sound, place_m):
    sample = moved(sound, place_m)
    fit = motion_fit(sample, innovation(sample))
    np.testing.assert_allclose(fit.origin_m, place_m, atol=0.01)
    assert fit.scale == pytest.approx(1.0, abs=0.005)


def test_the_scale_of_the_accelerometer_is_measured(sound):
    sample = replace(sound, force=1.05 * sound.force)
    assert motion_fit(sample, innovation(sample)).scale == pytest.approx(1.05, abs=0.005)
    assert named(sample) == ["accelerometer scale"]


def test_an_estimated_state_has_no_origin_of_its_own(sound):
    sample = moved(sound, (0.1, 0.0, 0.0))
    assert named(sample) == ["mocap origin"]
    assert named(sample, measured=False) == []
    assert named(sound) == []
