# SPDX-FileCopyrightText: 2026 The quadpi authors
# SPDX-License-Identifier: Apache-2.0
"""Renew results/hybrid.md: does a small network on what the physical model leaves err less on unseen flights?

The network sees the inputs of the model, the rotor speeds and their slopes, now and up to 0.2 s before, and
learns what the model leaves of the flights that it was identified on. Needs PyTorch.
"""

from __future__ import annotations

import argparse
import tempfile
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import torch
from intervals_raced import model_of
from model_methods import DATA_SETS, DataSet, Job, geometric, read, spread_over_speeds
from page_tables import RESULTS, renew, stamp

from quadpi_core.frames import Array
from quadpi_core.identification.prepared_flights import PreparedFlight
from quadpi_core.models.aerodynamic import AerodynamicModel
from quadpi_core.paths import data_directory
from quadpi_core.report.table import Column, Row, Table, markdown_table

PAGE = RESULTS / "hybrid.md"
# Every so many flights one is judged, and of the others one tells when to stop, and for which axes to trust.
TURNS, CHECKED = 4, 4
# s of the past that the network sees, and rate of the samples.
LAGS_S, RATE_HZ = (0.0, 0.04, 0.08, 0.12, 0.16, 0.2), 100.0
HIDDEN, STEPS, BATCH, EVERY = 48, 3000, 512, 100
RATE, DECAY = 2e-3, 1e-3
# Shares of the network's answer that are tried on the flights that check.
SHARES = (0.0, 0.25, 0.5, 0.75, 1.0)


@dataclass(frozen=True, eq=False)
class Left:
    """What a model leaves of a flight: seen (N, K) now and before, error (N, 6) in N and Nm."""

    seen: Array
    error: Array


def left_of(model: AerodynamicModel, flight: PreparedFlight) -> Left:
    """On the states of the live path."""
    live, known = flight.judged, flight.judged.known
    inputs, moving = live.inputs[known], live.derivatives[known]
    said = model.evaluate(inputs, model.confidence, moving)
    error = live.wrench[known] - 0.5 * (said.lower + said.upper)
    own = np.hstack((inputs, moving["rotor_speeds"], moving["rotor_accelerations"]))
    rate = 1.0 / float(np.median(np.diff(flight.time)))
    back = [round(lag * rate) for lag in LAGS_S]
    rows = np.arange(back[-1], len(own), max(round(rate / RATE_HZ), 1))
    return Left(np.hstack([own[rows - lag] for lag in back]), error[rows])


class Network:
    """A network of two layers on whitened numbers, stopped where the flights that check err least."""

    def __init__(self, learned: Sequence[Left], checked: Sequence[Left], seed: int) -> None:
        torch.manual_seed(seed)
        seen, error = (np.concatenate([getattr(one, name) for one in learned]) for name in ("seen", "error"))
        self._mean, self._spread = seen.mean(axis=0), seen.std(axis=0) + 1e-9
        self._size = np.sqrt(np.square(error).mean(axis=0)) + 1e-12
        layers = torch.nn.Sequential(
            *(torch.nn.Linear(seen.shape[1], HIDDEN), torch.nn.Tanh()),
            *(torch.nn.Linear(HIDDEN, HIDDEN), torch.nn.Tanh(), torch.nn.Linear(HIDDEN, error.shape[1])),
        )
        self._layers = layers
        inputs, wanted = self._whitened(seen), torch.tensor(error / self._size, dtype=torch.float32)
        optimiser = torch.optim.AdamW(layers.parameters(), lr=RATE, weight_decay=DECAY)
        least, best = np.inf, [values.clone() for values in layers.state_dict().values()]
        for step in range(STEPS):
            rows = torch.randint(len(inputs), (BATCH,))
            loss = torch.nn.functional.smooth_l1_loss(layers(inputs[rows]), wanted[rows])
            optimiser.zero_grad()
            loss.backward()
            optimiser.step()
            if step % EVERY == EVERY - 1:
                off = [np.square((one.error - self(one)) / self._size).mean() for one in checked]
                if np.mean(off) < least:
                    least = float(np.mean(off))
                    best = [values.clone() for values in layers.state_dict().values()]
        layers.load_state_dict(dict(zip(layers.state_dict(), best, strict=True)))

    def _whitened(self, seen: Array) -> torch.Tensor:
        # What no training flight reached says nothing: a network has no bound there.
        whitened = np.clip((seen - self._mean) / self._spread, -4.0, 4.0)
        return torch.tensor(whitened, dtype=torch.float32)

    def __call__(self, flight: Left) -> Array:
        """Its part (N, 6) of the wrench."""
        with torch.no_grad():
            said: Array = self._layers(self._whitened(flight.seen)).double().numpy() * self._size
        return said


def trusted(network: Network, checked: Sequence[Left]) -> Array:
    """Shares (6,) of the network's answer that err least on the flights that check."""
    errors = [
        np.mean([np.square(one.error - share * network(one)).mean(axis=0) for one in checked], axis=0)
        for share in SHARES
    ]
    shares: Array = np.array(SHARES)[np.argmin(errors, axis=0)]
    return shares


def rms(errors: Sequence[Array]) -> Array:
    """Root mean square (6,) by flight, of all flights."""
    return np.array([np.sqrt(np.square(error).mean(axis=0)) for error in errors])


def row_of(data_set: DataSet, flights: Sequence[PreparedFlight], turns: int, vehicle: object) -> Row:
    """Errors with the network over those without, on flights left out."""
    ratios, shares, mean = [], [], []
    for turn in range(turns):
        others = [flight for k, flight in enumerate(flights) if k % TURNS != turn]
        model = model_of(others, vehicle, "physical")  # type: ignore[arg-type]
        left = [left_of(model, flight) for flight in others]
        checked = left[1::CHECKED]
        learned = [one for k, one in enumerate(left) if k % CHECKED != 1]
        network = Network(learned, checked, turn)
        share = trusted(network, checked)
        shares.append(share)
        unseen = [left_of(model, flight) for flight in flights[turn::TURNS]]
        plain = rms([one.error for one in unseen])
        ratios.append(rms([one.error - share * network(one) for one in unseen]) / plain)
        # What a constant of each flight would take away, at most.
        mean.append(rms([one.error - one.error.mean(axis=0) for one in unseen]) / plain)
    all_ratios = np.concatenate(ratios)
    by_axis = np.exp(np.log(all_ratios).mean(axis=0))
    return [
        data_set.title,
        str(len(all_ratios)),
        *(f"{value:.2f}" for value in by_axis),
        f"{geometric(by_axis):.2f}",
        f"{100.0 * np.mean(all_ratios.mean(axis=1) < 1.0):.0f} %",
        f"{np.mean(shares):.2f}",
        f"{np.exp(np.log(np.concatenate(mean)).mean()):.2f}",
    ]


def main(arguments: Sequence[str] | None = None) -> None:
    """Renew the table after each data set."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--data", type=Path, default=data_directory(), help="folder of real flights")
    parser.add_argument("--page", type=Path, default=PAGE, help="to renew")
    parser.add_argument("--turns", type=int, default=TURNS, help="in which flights are left out, of four")
    parser.add_argument("--most", type=int, default=24, help="flights of a data set")
    options = parser.parse_args(arguments)
    torch.set_num_threads(1)
    headings = ("unseen flights", "Fx", "Fy", "Fz", "Mx", "My", "Mz", "all axes", "flights better")
    more = ("share trusted", "less a constant of the flight")
    columns = [Column("data set", is_text=True), *map(Column, (*headings, *more))]
    rows: list[Row] = []
    with tempfile.TemporaryDirectory() as folder:
        job = Job(options.data.resolve(), Path(folder), ("physical",), options.most)
        for data_set in DATA_SETS:
            everything, vehicle, _ = read(job, data_set)
            if len(everything) < 3:
                print(f"{data_set.title}: too few flights", flush=True)
                continue
            rows.append(
                row_of(data_set, spread_over_speeds(everything, options.most), options.turns, vehicle)
            )
            print(*rows[-1], sep=" | ", flush=True)
            table = markdown_table(Table(columns, rows))
            renew(options.page, {"hybrid": f"{table}\n\n{options.turns} of {TURNS} turns. *{stamp()}*"})


if __name__ == "__main__":
    main()
