# SPDX-FileCopyrightText: 2026 The quadpi authors
# SPDX-License-Identifier: Apache-2.0
"""Coefficients are adjusted where flights left out gain and no axis loses."""

from __future__ import annotations

import numpy as np

from quadpi_core.discrepancy.adjustment import Adjustment, LeftOut

FLIGHTS, ROWS, NOISE = 6, 400, 0.1


def adjustment(targets, columns, seed=0):
    """The choice for flights whose axes are `targets` of standard columns (axes 0 and 1), by their noise.

    Args:
        targets: (6, 1) or (6, c) what each column truly adds to each axis.
        columns: (6, c) what it adds as the simulation has it.
    """
    rng = np.random.default_rng(seed)
    rows = []
    for _ in range(FLIGHTS):
        motion = rng.standard_normal((ROWS, columns.shape[1]))
        residual = np.einsum("ac,bc->ab", targets, motion) + NOISE * rng.standard_normal((6, ROWS))
        rows.append(np.dstack((residual, columns[:, None, :] * motion)))
    grams = [np.einsum("abi,abj->ij", own, own) / NOISE**2 for own in rows]
    squares = [np.einsum("abi,abj->aij", own, own) for own in rows]
    flights = [
        LeftOut(sum(grams) - gram, gram, own, NOISE**2 * own)
        for gram, own in zip(grams, squares, strict=True)
    ]
    return Adjustment(flights, np.ones(columns.shape[1]), columns.shape[1])


def in_axes(*values):
    """Column (6, 1) of values of the first axes."""
    return np.append(values, np.zeros(6 - len(values)))[:, None]


def test_coefficients_that_help_are_all_adjusted():
    both = np.hstack((in_axes(1.0, 0.5), in_axes(0.0, 1.0)))
    np.testing.assert_array_equal(adjustment(both, both).chosen(), [0, 1])


def test_a_coefficient_by_which_one_axis_pays_for_another_is_not():
    """The first explains Fx alone; the second explains more of Fz, and disturbs My, which was right."""
    columns = np.hstack((in_axes(1.0), np.array([[0.0, 0.0, 1.0, 0.0, 0.5, 0.0]]).T))
    targets = columns.copy()
    targets[4] = 0.0
    np.testing.assert_array_equal(adjustment(targets, columns).chosen(), [0])


def test_a_coefficient_that_noise_moves_is_adjusted_or_not_without_harm():
    """With nothing to explain whatever is adjusted changes less than the noise."""
    none, columns = np.zeros((6, 3)), np.eye(6)[:, :3]
    chosen = [adjustment(none, columns, seed).chosen() for seed in range(20)]
    # Chance lets flights left out gain now and then.
    assert sum(len(own) for own in chosen) < 0.5 * 20 * 3
