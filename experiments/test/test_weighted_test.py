# SPDX-FileCopyrightText: 2026 The quadpi authors
# SPDX-License-Identifier: Apache-2.0
from __future__ import annotations

import numpy as np
from weighted_test import largest


def test_errors_are_evidence_where_such_inputs_are_known_and_not_where_they_are_new() -> None:
    random = np.random.default_rng(5)
    of_known = random.standard_normal((200, 2))
    # Errors grow with the first input.
    known = np.abs(of_known[:, 0]) + 0.1 * random.standard_normal(200)
    usual, far = random.standard_normal((20, 2)), np.column_stack((np.full(20, 2.0), np.zeros(20)))
    sound, faster = np.abs(usual[:, 0]), np.full(20, 1.9)
    assert max(largest(sound, usual, known, of_known, random)) < 20.0
    plain, weighted = largest(faster, far, known, of_known, random)
    assert plain >= 20.0 > weighted
    assert min(largest(sound + 3.0, usual, known, of_known, random)) >= 20.0
