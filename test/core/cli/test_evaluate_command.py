# SPDX-FileCopyrightText: 2026 The quadpi authors
# SPDX-License-Identifier: Apache-2.0
"""`quadpi evaluate`: groups of flights, and the JSON keys of their results."""

from __future__ import annotations

from pathlib import Path

import pytest

from quadpi_core.cli.model_commands import group_bags
from quadpi_core.errors import QuadpiError
from test.core.evaluation.test_evaluation_result import EVALUATION, METRICS


def test_evaluate(read_json, quadpi, model, bags, tmp_path):
    assert quadpi("evaluate", model, *bags[:2], "--json", tmp_path / "evaluation.json").status == 0
    evaluation = read_json(tmp_path / "evaluation.json")
    assert set(evaluation) == EVALUATION
    assert set(evaluation["groups"]) == {"all"}
    assert set(evaluation["groups"]["all"]) == {"flights", "axes", "alarm"}
    assert set(evaluation["flights"]) == {"flight0", "flight1"}
    for part in (evaluation["groups"]["all"], *evaluation["flights"].values()):
        assert set(part["axes"]) == {"Fx", "Fz", "Mx"}
        assert all(set(axis) == METRICS for axis in part["axes"].values())
    assert set(evaluation["flights"]["flight0"]) == {"duration_s", "axes", "alarm", "sha256", "in_sample"}


class TestGroups:
    A, B, C = Path("a.mcap"), Path("b.mcap"), Path("c.mcap")

    def test_positional_flights_are_the_group_all(self):
        assert group_bags([self.A, self.B], []) == {"all": [self.A, self.B]}

    def test_commas_and_repeats_add_up(self):
        assert group_bags([], ["slow=a.mcap,b.mcap", "fast=b.mcap", "slow=c.mcap"]) == {
            "slow": [self.A, self.B, self.C],
            "fast": [self.B],
        }

    def test_a_path_may_hold_the_sign(self):
        assert group_bags([self.A], ["x=run=1/b.mcap"]) == {"all": [self.A], "x": [Path("run=1/b.mcap")]}

    @pytest.mark.parametrize("text", ["a.mcap", "=a.mcap", "slow=", "", "slow=a.mcap,", "slow=,a.mcap"])
    def test_what_is_no_group_is_refused(self, text):
        with pytest.raises(QuadpiError, match=r"--group .*: expected NAME=BAG"):
            group_bags([self.A], [text])

    def test_no_flight_is_refused(self):
        with pytest.raises(QuadpiError, match="no flights given"):
            group_bags([], [])

    def test_a_flight_may_be_in_two_groups(self, read_json, quadpi, model, bags, tmp_path):
        groups = ("--group", f"one={bags[0]}", "--group", f"both={bags[0]},{bags[1]}")
        assert quadpi("evaluate", model, *groups, "--json", tmp_path / "data.json").status == 0
        evaluation = read_json(tmp_path / "data.json")
        assert evaluation["groups"]["both"]["flights"] == ["flight0", "flight1"]
        assert evaluation["groups"]["one"]["axes"] == evaluation["flights"]["flight0"]["axes"]
