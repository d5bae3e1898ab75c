# SPDX-FileCopyrightText: 2026 The quadpi authors
# SPDX-License-Identifier: Apache-2.0
"""What a researcher writes who knows scikit-learn and pandas alone, on bundled and on real flights."""

from __future__ import annotations

import re

import numpy as np
import pytest
from sklearn.base import clone
from sklearn.ensemble import RandomForestRegressor
from sklearn.model_selection import LeaveOneOut, cross_val_score

import quadpi_core as qp
from quadpi_core.paths import bags_directory

# From nothing to the coverage on unseen flights.
SIX_LINES = """
import quadpi_core as qp
flights = qp.load_flights("{learned}", "{vehicle}")
unseen = qp.load_flights("{unseen}", "{vehicle}")
model = qp.WrenchModel("polynomial").fit(flights)
table = qp.evaluate(model, unseen).to_pandas()
print(table.groupby("axis")["coverage"].mean())
"""
BUNDLED = (bags_directory() / "train_*.mcap", bags_directory() / "interpolation.mcap", "bebop2")


@pytest.fixture(scope="module", params=["bundled", "real"])
def logs(request):
    """Logs to learn from, unseen ones, and their vehicle; real ones are of the NeuroBEM data set."""
    if request.param == "bundled":
        return BUNDLED
    flown = request.getfixturevalue("shared_data") / "neurobem"
    return flown / "bemnn20210218*.mat", flown / "bemnn20210223104803seg2.mat", "neurobem"


@pytest.fixture(scope="module")
def flights(logs):
    learned, unseen, vehicle = logs
    return qp.load_flights(learned, vehicle=vehicle), qp.load_flights(unseen, vehicle=vehicle)


def test_coverage_in_six_lines(logs, capsys):
    learned, unseen, vehicle = logs
    script = SIX_LINES.format(learned=learned, unseen=unseen, vehicle=vehicle).strip()
    assert len(script.splitlines()) == 6
    exec(script, {})
    shares = [float(line.split()[1]) for line in capsys.readouterr().out.splitlines()[1:7]]
    assert min(shares) > 0.85


@pytest.mark.slow
def test_a_model_of_kinds_and_of_forests(flights, tmp_path):
    learned, unseen = flights
    for estimator in ("polynomial", RandomForestRegressor(n_estimators=3, max_depth=4, random_state=0)):
        model = qp.WrenchModel(estimator=estimator, confidence=0.95, axes=["Fx", "Fz"]).fit(learned)
        assert model.predict(unseen).shape == (len(unseen.time), 6)
        interval = model.predict_interval(unseen, confidence=0.9)
        assert np.all(interval.lower[:, [0, 2]] < interval.upper[:, [0, 2]])
        assert model.score(learned) > 0.5
        scores = cross_val_score(clone(model), learned[:3], cv=LeaveOneOut())
        assert np.isfinite(scores).all()
        table = qp.evaluate(model, unseen, by="speed", bins=5).to_pandas()
        assert list(table) == ["flight", "axis", "bin", "coverage", "low", "high", "width", "n"]
        model.save(tmp_path / "my-model")
        again = qp.load_model(tmp_path / "my-model").predict(unseen)
        assert np.allclose(again, model.predict(unseen), rtol=1e-9, atol=1e-9, equal_nan=True)


def test_a_table_there_and_back(flights, logs):
    frame = flights[1].to_pandas()
    again = qp.Flights.from_pandas(frame, flight="flight", time="time_ns", vehicle=logs[2], filtered=True)
    assert np.array_equal(again.wrench, flights[1].wrench)


def test_rows_of_a_monitor(flights):
    learned, unseen = flights
    monitor = qp.Monitor(qp.WrenchModel("polynomial", axes=["Fz"]).fit(learned))
    table, rows = unseen.to_pandas(), []
    for k in range(1000):
        row = table.iloc[k]
        rows += monitor.step(
            int(row["time_ns"]),
            velocity=row[["u_m_s", "v_m_s", "w_m_s"]].to_numpy(float),
            attitude=row[["qw", "qx", "qy", "qz"]].to_numpy(float),
            rates=row[["p_rad_s", "q_rad_s", "r_rad_s"]].to_numpy(float),
            specific_force=row[["force_x_m_s2", "force_y_m_s2", "force_z_m_s2"]].to_numpy(float),
            rotor_speeds=row[[f"rotor_{k}_rad_s" for k in (1, 2, 3, 4)]].to_numpy(float),
        )
    assert rows
    assert all(row.lower[2] < row.upper[2] for row in rows)


@pytest.mark.parametrize(
    ("guess", "instead"),
    [
        (lambda qp, flights: qp.fit(flights), r"WrenchModel\(estimator\)\.fit\(flights\)"),
        (lambda qp, _: qp.read_bag("a.mcap"), r"load_flights\(logs, vehicle\)"),
        (lambda qp, flights: qp.evaluation_of(flights), None),
        (lambda qp, _: qp.WrenchModel.load("model"), r"load_model\(folder\)"),
        (lambda qp, _: qp.WrenchModel().coef_, "model_, the fitted model"),
        (lambda qp, _: qp.WrenchModel().__array_interface__, None),
        (lambda qp, _: qp.Flights.from_csv("a.csv"), r"load_flights\(logs, vehicle\)"),
        (lambda _, flights: flights.plot(), r"model\.plot\(flight\)"),
        (lambda _, flights: flights.velocity, r"to_pandas\(\), a table of all signals"),
        (lambda qp, _: qp.Monitor.update, r"step\(time_ns, velocity"),
    ],
)
def test_a_guessed_name_names_the_right_one(training, guess, instead):
    with pytest.raises(AttributeError, match="has no attribute") as caught:
        guess(qp, training)
    assert ": use " in str(caught.value) if instead else ": use " not in str(caught.value)
    assert re.search(instead or "", str(caught.value))
