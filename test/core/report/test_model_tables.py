# SPDX-FileCopyrightText: 2026 The quadpi authors
# SPDX-License-Identifier: Apache-2.0
from quadpi_core.models.aerodynamic import AerodynamicModel
from quadpi_core.report.info_tables import best_known_table, selection_table, structure_table
from quadpi_core.report.table import terminal_table


def test_terms_are_in_the_order_of_selection(case, markdown_cells):
    again = [
        *case.model.selection["Fx"],
        {"term": "|v|*w", "coefficient": 2.0, "r2": 0.95, "fixed": False},
        {"term": "mu_x * omega_avg", "coefficient": 1.5, "r2": 0.96, "fixed": False},
    ]
    # A term that was taken out and came back stands where it came back; one that is left out, nowhere.
    selection = case.model.selection | {"Fx": again}
    heading, *body = markdown_cells(structure_table(selection, ["Fx", "Mz"]))
    assert heading == ["Fx", "coefficient", "R²", "Mz", "coefficient", "R²"]
    assert body[0] == ["*`1`*", "-2.000e-01", "–"] * 2
    assert body[1][:3] == ["`¦v¦*w`", "2.000e+00", "0.9500"]
    assert [row[0] for row in body] == ["*`1`*", "`¦v¦*w`", "`mu_x * omega_avg`"]


def test_selection_table_shows_what_the_model_holds(case, rendered):
    text = rendered(terminal_table(selection_table(case.model.selection["Fx"], "Fx")))
    (kept,) = [line.split() for line in text.splitlines() if "mu_x" in line]
    assert kept == ["mu_x", "*", "omega_avg", "1.5000e+00", "0.9000", "0.100"]
    (out,) = [line.split() for line in text.splitlines() if line.strip().startswith("p ")]
    assert out[1] == "–"


def test_the_best_known_parameters_come_first(case, predicting):
    table = best_known_table(AerodynamicModel.load(predicting), 5)
    assert table is not None
    known = [abs(row[1]) / row[2] for row in table.rows]
    assert len(known) == 5
    assert known == sorted(known, reverse=True)
    assert "thrust" in {row[0] for row in table.rows}
    # A polynomial has terms, and no standard errors to show.
    assert best_known_table(case.model, 5) is None
