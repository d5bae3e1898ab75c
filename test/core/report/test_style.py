# SPDX-FileCopyrightText: 2026 The quadpi authors
# SPDX-License-Identifier: Apache-2.0
import pytest

from quadpi_core.report.table import number, percent


@pytest.mark.parametrize(
    ("fraction", "text"),
    [(0.95, "95.0 %"), (1.0, "100.0 %"), (0.99991, "> 99.9 %"), (0.0, "0.0 %"), (1e-5, "< 0.1 %")],
)
def test_percent_never_rounds_to_certainty(fraction, text):
    assert percent(fraction) == text


@pytest.mark.parametrize(
    ("value", "text"),
    [(0.4, "0.400"), (469.2, "469"), (999.7, "1000"), (38779, "38779"), (1.2e-5, "1.20e-05")],
)
def test_numbers_have_three_digits(value, text):
    assert number(value) == text
