# SPDX-FileCopyrightText: 2026 The quadpi authors
# SPDX-License-Identifier: Apache-2.0
"""What is my simulation missing? A function that knows no drag, beside flights that have it.

In an editor that knows cells `# %%`, run them one by one.
"""

# %% Flights of the bundled bags.
from __future__ import annotations

from quadpi_core import find_discrepancy, load_flights, load_simulation
from quadpi_core.flight import Flight
from quadpi_core.frames import Array
from quadpi_core.paths import bags_directory

flights = load_flights([bags_directory() / f"train_{k}.mcap" for k in (1, 2)], vehicle="bebop2")
known = load_simulation("bebop2")


# %% My simulation: any function from a flight to forces and moments (N, 6), body axes forward-right-down.
def without_side_force(flight: Flight) -> Array:
    """The bundled simulation, but that rotors and airframe push neither forward nor aside."""
    wrench = known.wrench(flight)
    wrench[:, :2] = 0.0
    return wrench


# %% Which effect is missing, and where it shows.
found = find_discrepancy(without_side_force, flights, effects=["body_drag", "rotor_drag"])
print(found)
print(*found.where, *found.doubts, sep="\n")
print(found.to_pandas())
