# SPDX-FileCopyrightText: 2026 The quadpi authors
# SPDX-License-Identifier: Apache-2.0
"""Manoeuvre against vehicle by a weighted conformal test martingale, on real flights of a Crazyflie.

D. Prinster et al., "WATCH: adaptive monitoring for AI deployments via weighted-conformal martingales"
(2025, arXiv:2505.04608). Scores of blocks of half a second become p-values among those of flights left out,
each weighted by how much likelier inputs like its own are in the flight that is judged, so far, than in
those. Evidence that stays is of the vehicle; without weights it is of both. Prints how many flights gather
20 to 1.
"""

from __future__ import annotations

import argparse
from collections.abc import Sequence
from pathlib import Path

import numpy as np
from alarm_tables import model_of
from change_tables import LADEN, METHOD, VEHICLE, all_faster, flights_of
from sklearn.linear_model import LogisticRegression

from quadpi_core.errors import LogError
from quadpi_core.flight import AXES
from quadpi_core.frames import Array
from quadpi_core.identification.prepared_flights import PreparedFlight, prepare_flights, prepare_recording
from quadpi_core.inputs import INPUT_NAMES
from quadpi_core.logs import read_recording
from quadpi_core.models.aerodynamic import AerodynamicModel
from quadpi_core.models.model_kind import CUTOFF_HZ
from quadpi_core.paths import data_directory
from quadpi_core.vehicle import Vehicle

BLOCK_S, STEP = 0.5, 0.01
_JUDGED = [AXES.index(axis) for axis in ("Fx", "Fy", "Fz", "Mx", "My")]
# A heavier vehicle has others however it flies.
_OF_THRUST = ("omega_avg", "v_in", "mu_v_in")
_MOTION = [k for k, name in enumerate(INPUT_NAMES) if name not in _OF_THRUST]
_SLOWER = 8


def blocks(model: AerodynamicModel, flight: PreparedFlight) -> tuple[Array, Array]:
    """Of each block the root mean squares (B, 5) of residuals, and features (B, 32) of its inputs."""
    live = flight.judged
    said = model.fitted.evaluate(live.inputs, model.fitted.factors(model.confidence), live.derivatives)
    errors = (live.wrench - 0.5 * (said.lower + said.upper))[:, _JUDGED]
    number = ((flight.time - flight.time[0]) // BLOCK_S).astype(int)
    found = [(number == k) & live.known for k in range(number[-1])]
    found = [rows for rows in found if np.count_nonzero(rows) > 10]
    squares = np.array([np.sqrt(np.mean(np.square(errors[rows]), axis=0)) for rows in found])
    inputs = [live.inputs[rows][:, _MOTION] for rows in found]
    return squares, np.array([np.append(of.mean(axis=0), np.abs(of).max(axis=0)) for of in inputs])


def largest(
    scores: Array, features: Array, known: Array, of_known: Array, random: np.random.Generator
) -> tuple[float, float]:
    """Largest evidence of a flight, without and with weights: simple jumper martingales."""
    middle, scale = of_known.mean(axis=0), of_known.std(axis=0) + 1e-9
    calibration, judged = (of_known - middle) / scale, (features - middle) / scale
    top = []
    for is_weighted in (False, True):
        parts, most = np.full(3, 1.0 / 3.0), 1.0
        for t, score in enumerate(scores):
            weights, own = np.ones(len(known)), 1.0
            if is_weighted and t:
                rows = np.concatenate((calibration, judged[:t]))
                labels = np.append(np.zeros(len(calibration)), np.ones(t))
                told = LogisticRegression(C=0.1, class_weight="balanced", max_iter=200).fit(rows, labels)
                asked = np.concatenate((calibration, judged[t : t + 1]))
                odds = np.exp(np.clip(told.decision_function(asked), -8.0, 8.0))
                weights, own = odds[:-1], float(odds[-1])
            total = float(weights.sum()) + own
            p = (float(weights[known > score].sum()) + random.uniform() * own) / total
            parts = (1.0 - STEP) * parts + STEP * parts.sum() / 3.0
            parts = parts * (1.0 + np.array([-1.0, 0.0, 1.0]) * (p - 0.5) * 2.0)
            most = max(most, float(parts.sum()))
        top.append(most)
    return top[0], top[1]


def judge(data: Path, split: int) -> None:
    """Print a table of random halves."""
    vehicle, random = Vehicle.load(VEHICLE), np.random.default_rng(split)
    paths, laden = flights_of(data, split), sorted((data / LADEN).iterdir())

    def prepared(files: Sequence[Path]) -> list[PreparedFlight]:
        return prepare_flights(files, vehicle, CUTOFF_HZ["default"])

    half = sorted(paths)[len(paths) // 2]
    slower = [path for path in paths if path < half][:_SLOWER]
    for name, train, test in (
        ("faster flights", slower, [path for path in paths if path >= half]),
        ("sound", paths[::2], paths[1::2]),
        ("payload", paths[::2], laden),
        ("3 % less thrust", paths[::2], paths[1::2]),
    ):
        if name in ("faster flights", "sound"):
            flights = prepared(train)
            model = model_of(flights, VEHICLE, METHOD)
            left = []
            for k in (0, 1):
                fold = model_of(flights[1 - k :: 2], VEHICLE, METHOD)
                left += [blocks(fold, flight) for flight in flights[k::2]]
            squares, of_known = (np.concatenate(part) for part in zip(*left, strict=True))
            scale = np.sqrt(np.mean(np.square(squares), axis=0))
            known = (squares / scale).max(axis=1)
        counts = np.zeros(3, dtype=int)
        for path in test:
            recording = read_recording(path, vehicle)
            if name.startswith("3"):
                recording = all_faster(recording, 0, 0, 0.03)
            try:
                own, features = blocks(model, prepare_recording(recording, vehicle, CUTOFF_HZ["default"]))
            except LogError as error:
                # A pause that states cannot be smoothed across.
                print(error)
                continue
            plain, weighted = largest((own / scale).max(axis=1), features, known, of_known, random)
            counts += (1, plain >= 20.0, weighted >= 20.0)
        print(split, name, "flights, 20 to 1 without, with weights:", *counts, flush=True)


def main() -> None:
    """Two random splits."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--data", type=Path, default=data_directory(), help="folder of real flights")
    parser.add_argument("--split", type=int, nargs="+", default=[1, 2], help="seeds of random halves")
    options = parser.parse_args()
    for split in options.split:
        judge(options.data.resolve(), split)


if __name__ == "__main__":
    main()
