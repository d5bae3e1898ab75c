# SPDX-FileCopyrightText: 2026 The quadpi authors
# SPDX-License-Identifier: Apache-2.0
"""Identify a model on flights, and judge its intervals on flights that it did not see.

In an editor that knows cells `# %%`, run them one by one. Flights of the NeuroBEM data set where they are
(`$QUADPI_DATA`), else the bundled ones, which are simulated.
"""

# %% Flights: three or more to learn from, one to judge.
from __future__ import annotations

import quadpi_core as qp
from quadpi_core.paths import bags_directory, data_directory

real = sorted((data_directory() / "neurobem").glob("*.mat"))
vehicle = "neurobem" if real else "bebop2"
logs = real or [
    bags_directory() / f"{name}.mcap" for name in ("train_1", "train_2", "train_3", "interpolation")
]
flights = qp.load_flights(logs, vehicle)
training, unseen = flights[[0, 2, 3]], flights[1]
print(training)

# %% A polynomial of the forces takes seconds; "physical" extrapolates better.
model = qp.WrenchModel(estimator="polynomial", confidence=0.95, axes=["Fx", "Fy", "Fz"], keep_flawed=True)
model.fit(training)
print(model, f"R² of {model.score(unseen):.3f}")

# %% Do the intervals hold, slow and fast?
table = qp.evaluate(model, unseen, by="speed", bins=4)
print(table)
print(table.to_pandas().pivot_table(index="bin", columns="axis", values="coverage", observed=True))

# %% Keep it.
if __name__ == "__main__":
    print(model.save("judged-model"))
