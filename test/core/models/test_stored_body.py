# SPDX-FileCopyrightText: 2026 The quadpi authors
# SPDX-License-Identifier: Apache-2.0
from __future__ import annotations

import numpy as np
import pytest

from quadpi_core.errors import ModelError
from quadpi_core.models.physical_terms import TERM_NAMES, TERMS, physical_vehicle
from quadpi_core.models.rollout_model import StoredBody
from test.core.models.physical_flights import REFERENCE, VEHICLE, known_parameters

BODY = StoredBody(
    known_parameters(), np.eye(len(TERMS)), physical_vehicle(VEHICLE, REFERENCE), VEHICLE.inertia
)


def test_what_was_stored_is_read_whatever_the_order_of_its_terms() -> None:
    arrays, order = BODY.arrays("values"), np.arange(len(TERMS))[::-1]
    turned = {
        **arrays,
        "values": arrays["values"][order],
        "covariance": arrays["covariance"][order][:, order],
    }
    for names, own in ((TERM_NAMES, arrays), (TERM_NAMES[::-1], turned)):
        for before, after in zip(BODY, StoredBody.read(names, own, "values"), strict=True):
            np.testing.assert_array_equal(after, before)


def test_parameters_of_another_version_are_refused() -> None:
    with pytest.raises(ModelError, match="parameter 'warp' is not known to this version"):
        StoredBody.read(["warp", *TERM_NAMES[1:]], BODY.arrays("values"), "values")
    with pytest.raises(ModelError, match="inertia is missing"):
        StoredBody.read(TERM_NAMES, {"values": BODY.values, "covariance": BODY.covariance}, "values")
