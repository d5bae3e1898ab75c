# SPDX-FileCopyrightText: 2026 The quadpi authors
# SPDX-License-Identifier: Apache-2.0
"""The bags that come with quadpi are those that its simulation makes."""

from __future__ import annotations

import json

import pytest

from quadpi_core.logs.bag_files import Bag
from quadpi_core.paths import bags_directory
from quadpi_core.simulation import simulated_bags
from quadpi_core.simulation.scenario import load_scenario
from quadpi_core.simulation.simulated_bags import simulate

LARGEST_MB = 25
REMADE = "faults"
PLANS = {plan.name: plan for plan in load_scenario("bundled").flights}


def metadata(path):
    with Bag(path) as bag:
        return bag.metadata


def test_there_is_a_bag_of_every_flight_and_no_other():
    found = sorted(bags_directory().glob("*.mcap"))
    assert [path.stem for path in found] == sorted(PLANS)
    assert sum(path.stat().st_size for path in found) < 1e6 * LARGEST_MB


@pytest.mark.parametrize("name", PLANS)
def test_bag_holds_the_plan_as_it_is_now(name):
    assert json.loads(metadata(bags_directory() / f"{name}.mcap")["plan"]) == PLANS[name].as_dict()


def test_a_bag_is_made_again_byte_for_byte(monkeypatch, tmp_path):
    original = bags_directory() / f"{REMADE}.mcap"
    # A later version of quadpi need not ship new bags that differ in nothing but its name.
    monkeypatch.setattr(simulated_bags, "__version__", metadata(original)["version"])
    (flight,) = simulate([PLANS[REMADE]], tmp_path)
    assert flight.bag.read_bytes() == original.read_bytes()
