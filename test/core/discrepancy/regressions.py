# SPDX-FileCopyrightText: 2026 The quadpi authors
# SPDX-License-Identifier: Apache-2.0
"""Regressions of short flights beside a simulation whose noise is known."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from quadpi_core.discrepancy.candidates import candidates
from quadpi_core.discrepancy.effect_regression import Regression
from quadpi_core.discrepancy.effect_response import Compared
from quadpi_core.discrepancy.whitening import EDGES_HZ
from quadpi_core.flight import AXES
from quadpi_core.models.sound_flights import SoundFlights

NAMES = ["body_drag", "payload", "wind"]
DRAG, PAYLOAD, WIND = range(3)
VARIANCE = np.repeat([[0.03**2], [3e-3**2]], 3, axis=0)


def of_sound_flights(simulation, *names):
    """The simulation, of which sound flights show that it lacks 0.02 ± 0.01 kg, and 0.003 of each flight."""
    bands = VARIANCE * np.ones((len(AXES), len(EDGES_HZ.value) - 1))
    each = np.ones(len(names))
    error = 0.02 * each, 0.01**2 * np.diag(each), 0.003 * each
    sound = SoundFlights(8, EDGES_HZ.value, bands, bands, np.zeros(len(AXES)), names, *error)
    return replace(simulation, sound=sound)


def regression_of(simulation, flights, names, *, samples=1000):
    """Of flights cut to 8 s or some samples, on candidates in the order of their names."""
    compared = [Compared(flight.slice(slice(0, samples)), simulation) for flight in flights]
    chosen = {own.name: own for own in candidates(simulation.vehicle, names)}
    return Regression.from_flights(compared, [chosen[name] for name in names])


def rows_in(regression, place, wrench):
    """Rows (6, B) of a wrench (M, 6) of a flight."""
    return regression.flights[place].spectrum(wrench[:, :, None]).rows[:, :, 0]


def rows(columns, place):
    return columns.spectra[place].rows
