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


def test_what_matters_comes_first_and_the_rest_is_asked_for(quadpi, bags, pool, read_json, tmp_path):
    base = ("identify", *bags[:2], "--vehicle", "neurobem", "--candidates", pool, "--confidence", "0.999")
    short, whole = (quadpi(*base, "-o", tmp_path / "model", *more) for more in ((), ("--verbose",)))
    assert (short.status, whole.status) == (0, 0)
    assert set(short.output.splitlines()) <= set(whole.output.splitlines())
    assert "thrust coefficient C_T, hover" in short.output
    assert "R² reached" not in short.output
    assert "R² reached" in whole.output
    level = "1 flight supports a level of 50 % (n / (n + 1)), not 99.9 %: about 50 % of flights to come"
    assert level in short.output
    data, page = tmp_path / "data.json", tmp_path / "page.html"
    judged = quadpi("evaluate", tmp_path / "model", bags[2], "--json", data, "--html", page)
    assert level in " ".join(judged.output.split())
    assert level in page.read_text()
    support = {"confidence": 0.999, "flights": 1, "level": 0.5, "flight_share": 0.5}
    assert read_json(data)["support"] == support
