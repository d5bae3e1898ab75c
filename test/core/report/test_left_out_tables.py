# SPDX-FileCopyrightText: 2026 The quadpi authors
# SPDX-License-Identifier: Apache-2.0
from dataclasses import replace

import pytest

from quadpi_core.flight import AXES
from quadpi_core.report.left_out_tables import ideal_width, left_out_summary, left_out_table


def test_width_is_stated_over_that_of_an_ideal_interval(comparison, markdown_cells):
    metrics = comparison.models["poly"].groups["known"].axes["Fx"]
    assert ideal_width(replace(metrics, rmse=2.0), 0.95) == pytest.approx(2.0 * 1.95996 * 2.0, rel=1e-5)
    models = {
        name: replace(model, groups={"all": model.groups["known"]})
        for name, model in comparison.models.items()
    }
    one = replace(comparison, groups={"all": ["slow"]}, models=models)
    results = {"3 m/s": {"fixed": one, "adaptive": one}, "8 m/s": {"fixed": one, "adaptive": one}}
    ratio = metrics.mpiw / (2.0 * 1.95996 * metrics.rmse)
    covered = f"{100 * metrics.picp:.1f}"
    heading, *body = markdown_cells(left_out_table(results))
    assert heading == ["flight", "model", "intervals", *AXES]
    assert body[0][:4] == ["3 m/s", "poly-paper", "fixed", f"{covered} · {ratio:.2f}"]
    assert [row[0] for row in body if row[0]] == ["3 m/s", "8 m/s"]
    assert body[5][5:] == [body[4][5], "", "", ""]
    assert markdown_cells(left_out_summary(results))[1][2] == f"{covered} / {covered} · {ratio:.2f}"
