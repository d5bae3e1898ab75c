# SPDX-FileCopyrightText: 2026 The quadpi authors
# SPDX-License-Identifier: Apache-2.0
from __future__ import annotations

import numpy as np
import pytest

pytest.importorskip("torch")

from hybrid import Left, Network, trusted


def test_a_network_is_trusted_where_what_is_left_repeats_and_not_where_it_is_noise(monkeypatch) -> None:
    monkeypatch.setattr("hybrid.STEPS", 400)
    random = np.random.default_rng(3)

    def flight() -> Left:
        seen = random.standard_normal((400, 4))
        error = random.standard_normal((400, 6))
        error[:, 0] = seen[:, 0] * seen[:, 1]
        return Left(seen, error)

    learned, checked, unseen = ([flight() for _ in range(count)] for count in (6, 2, 2))
    network = Network(learned, checked, 0)
    shares = trusted(network, checked)
    assert shares[0] >= 0.75
    left, noise = (
        np.concatenate([of(one) for one in unseen])
        for of in (
            lambda one: one.error - shares * network(one),
            lambda one: one.error,
        )
    )
    ratio = np.sqrt(np.square(left).mean(axis=0) / np.square(noise).mean(axis=0))
    assert ratio[0] < 0.6
    assert np.all(ratio[1:] < 1.05)
