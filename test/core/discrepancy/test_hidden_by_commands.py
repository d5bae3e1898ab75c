# SPDX-FileCopyrightText: 2026 The quadpi authors
# SPDX-License-Identifier: Apache-2.0
"""Bags of commands alone, from the command and from the library; what is said of their speeds."""

from __future__ import annotations

import json
from dataclasses import replace

import pytest

from quadpi_core.discrepancy.discrepancy_result import CommandedSpeeds
from quadpi_core.library.flights import load_flights
from quadpi_core.library.found_discrepancy import find_discrepancy
from quadpi_core.logs import read_recording
from quadpi_core.paths import bags_directory
from quadpi_core.vehicle import Vehicle

from ..commanded_bags import write_bag
from ..messages.adapters.vendor_messages import DEFINITIONS, Messages


def test_what_is_said_of_speeds_names_their_scatter_and_what_looks_like_them():
    alike = (("payload", (0.03, -0.01, 0.03, 0.03)),)
    said = CommandedSpeeds(("one",), 0.005, 0.01, scale_known=False, alike=alike).sentences
    assert "scatters by 0.5 %, that of single rotors by 1 %" in said[0]
    assert "cannot be told apart" in said[1]
    assert said[2].startswith("Payload looks as if the motors turned by +3.0, -1.0, +3.0, +3.0 %")


@pytest.fixture(scope="module")
def bags(tmp_path_factory):
    """Four bundled flights as bags of commands and battery."""
    folder, messages, vehicle = tmp_path_factory.mktemp("bags"), Messages(DEFINITIONS), Vehicle.load("bebop2")
    names = [f"train_{number}" for number in (1, 2, 3, 4)]
    read = [replace(read_recording(bags_directory() / f"{name}.mcap", vehicle), name=name) for name in names]
    return [write_bag(folder / one.name, messages, one, "px4_motors") for one in read]


def test_bags_with_commands_alone_are_searched(bags, tmp_path, quadpi):
    told = quadpi("discrepancy", "bebop2", *bags, "-o", tmp_path / "found", "--effects", "body_drag,wind")
    assert told.status == 0, told.errors
    said = " ".join(told.output.split())
    assert "Rotor speeds are made of motor commands: from flight to flight" in said
    found = json.loads((tmp_path / "found" / "discrepancy.json").read_text())
    commanded = found["rotor_speeds_from_commands"]
    assert (found["effects"], commanded["scale_known"]) == ([], False)
    assert len(commanded["flights"]) == 4
    assert "Rotor speeds are made of motor commands" in (tmp_path / "found" / "discrepancy.html").read_text()


@pytest.mark.slow
def test_the_library_searches_flights_by_commands(bags):
    found = find_discrepancy("bebop2", load_flights([str(path) for path in bags], "bebop2"), effects=["wind"])
    assert found.study.discovery.commanded.gain > 0.0
