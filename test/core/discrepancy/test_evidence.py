# SPDX-FileCopyrightText: 2026 The quadpi authors
# SPDX-License-Identifier: Apache-2.0
"""Fits of sets of effects from Gram matrices."""

from __future__ import annotations

import numpy as np
import pytest

from quadpi_core.discrepancy.evidence import Block, fit

NONE = np.array([], dtype=np.intp)
RESIDUAL, LAW, FORM = range(3)


def block(form=NONE):
    return Block(
        parameters=np.array([LAW]),
        form=form,
        formed_at=1.0,
        offset=None,
        lowest=np.array([0.0]),
        highest=np.array([5.0]),
    )


def gram(law, form, residual):
    columns = np.stack((residual, law, form), axis=1)
    return columns.T @ columns


@pytest.fixture
def shapes():
    rng = np.random.default_rng(0)
    return rng.standard_normal(400), rng.standard_normal(400)


def test_form_columns_that_are_not_needed_cost_no_evidence(shapes):
    law, other = shapes
    found = fit(gram(law, other, 2.0 * law), NONE, [block()])
    assert found.of(np.array([LAW]))[0] == pytest.approx(2.0, rel=0.01)
    with_form = fit(gram(law, other, 2.0 * law), NONE, [block(np.array([FORM]))])
    assert with_form.log_evidence == found.log_evidence
    assert fit(gram(law, other, -2.0 * law), NONE, [block()]) is None


def test_form_columns_that_would_flip_the_sign_of_a_law_are_left_out(shapes):
    law, other = shapes
    # 0.1 law + 0.3 other = 0.6 form − 0.5 law.
    form = law + 0.5 * other
    table = gram(law, form, 0.1 * law + 0.3 * other)
    exact = fit(table, NONE, [block()])
    assert exact is not None
    found = fit(table, NONE, [block(np.array([FORM]))])
    assert found is not None
    assert found.of(np.array([LAW]))[0] == exact.of(np.array([LAW]))[0] > 0.0
