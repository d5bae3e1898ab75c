# SPDX-FileCopyrightText: 2026 The quadpi authors
# SPDX-License-Identifier: Apache-2.0
"""`quadpi identify`: its options decide what the model holds."""

from __future__ import annotations


def test_axes_and_confidence_are_those_asked_for(read_json, quadpi, bags, pool, tmp_path):
    model, data = tmp_path / "model", tmp_path / "data.json"
    base = ("identify", *bags, "--vehicle", "neurobem", "--candidates", pool, "-o", model)
    identified = quadpi(*base, "--axes", "Fz", "--confidence", "0.9", "--cutoff-hz", "12")
    assert identified.status == 0
    assert "--method polynomial: physical, the default, takes no --candidates\n" in identified.output
    assert quadpi("info", model, "--json", data).status == 0
    info = read_json(data)
    assert (list(info["axes"]), info["confidence"], info["cutoff_hz"]) == (["Fz"], 0.9, 12.0)
    widths = []
    for options in ((), ("--confidence", "0.99")):
        assert quadpi("evaluate", model, bags[0], *options, "--json", data).status == 0
        widths.append(read_json(data)["groups"]["all"]["axes"]["Fz"]["mpiw"])
    assert widths[0] < widths[1]
