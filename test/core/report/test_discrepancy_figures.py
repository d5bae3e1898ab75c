# SPDX-FileCopyrightText: 2026 The quadpi authors
# SPDX-License-Identifier: Apache-2.0
import numpy as np
import pytest

from quadpi_core.discrepancy.residual_bins import Residual
from quadpi_core.report.discrepancy_figures import mean_map


def test_maps_hold_the_mean_of_what_was_measured_more_than_simulated():
    u, v = np.meshgrid(np.linspace(-3.9, 3.9, 60), np.linspace(-3.9, 3.9, 60))
    wrench = np.zeros((u.size, 6))
    wrench[:, 0] = -0.1 * u.ravel()
    flight = Residual("a", np.arange(u.size) / 40.0, {"u": u.ravel(), "v": v.ravel()}, wrench, wrench, wrench)
    x, y, table = mean_map([flight], 0, "u", "v")
    assert table.shape == (len(y) - 1, len(x) - 1)
    centres = 0.5 * (x[:-1] + x[1:])
    assert np.nanmean(table, axis=0) == pytest.approx(-0.1 * centres, abs=0.02)
    empty = mean_map(
        [flight._replace(variables={"u": u.ravel(), "v": np.abs(v.ravel()) * 0.01})], 0, "u", "v"
    )
    assert np.isfinite(empty[2]).any()
