# SPDX-FileCopyrightText: 2026 The quadpi authors
# SPDX-License-Identifier: Apache-2.0
"""A regressor of my own, with intervals calibrated by flight, beside a polynomial on the same flights.

In an editor that knows cells `# %%`, run them one by one. Needs scikit-learn and pandas.
"""

# %% Flights of the bundled bags.
from __future__ import annotations

import pandas as pd
from sklearn.ensemble import ExtraTreesRegressor
from sklearn.model_selection import LeaveOneOut, cross_val_score

import quadpi_core as qp
from quadpi_core.paths import bags_directory

training = qp.load_flights(f"{bags_directory()}/train_*.mcap", vehicle="bebop2")
unseen = qp.load_flights(bags_directory() / "interpolation.mcap", vehicle="bebop2")

# %% Any object with fit(X, y) and predict(X); each flight is one sample of the folds.
trees = qp.WrenchModel(ExtraTreesRegressor(5, max_depth=8, random_state=0), axes=["Fz"])
print(cross_val_score(trees, training, cv=LeaveOneOut()))

# %% The same judgement for both.
models = {"trees": trees.fit(training), "polynomial": qp.WrenchModel("polynomial", axes=["Fz"]).fit(training)}
judged = {name: qp.evaluate(model, unseen, bins=3).to_pandas() for name, model in models.items()}
table = pd.concat(judged, names=["model"])
print(table[["bin", "coverage", "low", "high", "width", "n"]])
