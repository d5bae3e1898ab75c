# SPDX-FileCopyrightText: 2026 The quadpi authors
# SPDX-License-Identifier: Apache-2.0
"""Commands on models: identify, replay, evaluate, rollout and validate."""

from __future__ import annotations

from pathlib import Path

import pytest

from quadpi_core.cli.model_commands import group_bags
from quadpi_core.errors import QuadpiError
from quadpi_core.flight import AXES
from quadpi_core.paths import bags_directory
from test.core.evaluation.test_evaluation_result import EVALUATION, METRICS


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


# `quadpi replay`: the JSON keys for one flight and for several, whose bags are those of each alone.


REPLAY = {
    "samples_in",
    "predictions_out",
    "dropped",
    "alarm_fraction",
    "alarm_first_s",
    "warning_first_s",
    "events",
    "not_judged_fraction",
    "not_judged_reasons",
}


def test_replay(read_json, quadpi, model, bags, tmp_path):
    output = tmp_path / "out.mcap"
    assert quadpi("replay", model, bags[0], "-o", output, "--json", tmp_path / "replay.json").status == 0
    assert set(read_json(tmp_path / "replay.json")) == REPLAY


def test_replay_of_several(read_json, quadpi, model, bags, tmp_path):
    out, data = tmp_path / "out", tmp_path / "replay.json"
    replayed = quadpi("replay", model, *bags, "-o", out, "--json", data)
    assert (replayed.status, replayed.errors) == (0, "")
    flights = read_json(data)["flights"]
    assert read_json(data) == {"flights": flights, "left_out": []}
    assert all(bag.stem in replayed.output for bag in bags)
    assert list(flights) == ["flight0", "flight1", "flight2"]
    assert sorted(path.name for path in out.iterdir()) == [bag.name for bag in bags]
    alone = tmp_path / "alone.mcap"
    assert quadpi("replay", model, bags[1], "-o", alone, "--json", data).status == 0
    assert read_json(data) == flights["flight1"]
    assert alone.read_bytes() == (out / "flight1.mcap").read_bytes()


# `quadpi evaluate`: groups of flights, and the JSON keys of their results.


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


# `quadpi rollout`: its table, the keys of its JSON, and what it refuses.


def test_rollout(read_json, quadpi, predicting, bags, tmp_path) -> None:
    files = "--json", tmp_path / "rollouts.json", "--html", tmp_path / "rollouts.html"
    outcome = quadpi("rollout", predicting, *bags[1:], "--horizon", "0.5", *files)
    assert outcome.status == 0
    assert "split conformal" in " ".join(outcome.output.split())
    result = read_json(tmp_path / "rollouts.json")
    assert set(result["flights"]) == {"flight1", "flight2"}
    for flight in result["flights"].values():
        assert set(flight["horizons"]) == {"0.01", "0.1", "0.5"}
        for horizon in flight["horizons"].values():
            assert set(horizon) == {"position_m", "velocity_m_s", "attitude_deg", "rates_rad_s"}
            for own in horizon.values():
                assert {"rms", "coverage", "width"} <= set(own)
                assert 0.0 <= own["coverage"] <= 1.0
    page = (tmp_path / "rollouts.html").read_text()
    assert all(f'data-flight="{flight}"' in page for flight in result["flights"])
    assert f"flight2.mcap --model {predicting}" in page


def test_a_model_that_is_no_simulation_is_refused(refused, model, bags) -> None:
    refused(
        r"\(polynomial\) predicts the wrench of single samples: it is no simulation",
        "rollout",
        model,
        bags[2],
    )


def test_a_horizon_beyond_the_calibration_is_refused(refused, predicting, bags) -> None:
    refused("a horizon of 5 s", "rollout", predicting, bags[2], "--horizon", "5")


# `quadpi validate`: its numbers are those of its realisations, which a later run resumes.


MODEL = Path(__file__).parents[2] / "golden" / "model"
FLIGHT = bags_directory() / "interpolation.mcap"
RESULT = {
    *("quadpi_version", "vehicle", "confidence", "seed", "realisations", "cutoff_hz", "noise"),
    *("flights", "models", "published"),
}


@pytest.fixture
def validated(quadpi, read_json, tmp_path):
    """validated(option, …) → the JSON file."""

    def run(*options):
        result = quadpi("validate", MODEL, FLIGHT, "--json", tmp_path / "data.json", "--workers", 1, *options)
        assert (result.status, result.errors) == (0, "")
        return read_json(tmp_path / "data.json")

    return run


def test_more_realisations_go_on_from_those_that_are_kept(validated, tmp_path):
    few = validated("--realisations", 2, "-o", tmp_path / "kept")
    kept = sorted((tmp_path / "kept").rglob("*.npz"))
    assert kept
    alone = validated("--realisations", 3)
    resumed = validated("--realisations", 3, "-o", tmp_path / "kept")
    assert resumed == alone
    assert set(kept) <= set((tmp_path / "kept").rglob("*.npz"))
    assert (few["realisations"], alone["realisations"]) == (2, 3)
    assert set(few) == RESULT
    (model,) = few["models"].values()
    assert set(model["axes"]) <= set(AXES)
    assert few["published"] is None


def test_seed_confidence_and_page(validated, tmp_path):
    found = validated(
        *("--realisations", 2, "--seed", 5, "--confidence", 0.9, "--html", tmp_path / "page.html")
    )
    assert (found["seed"], found["confidence"], found["vehicle"]) == (5, 0.9, "bebop2")
    assert "interpolation" in (tmp_path / "page.html").read_text()


def test_models_and_bags_are_needed(quadpi, refused):
    for given in ((), ("--realisations", 2)):
        ran = quadpi("validate", *given)
        assert ran.status == 2
        assert "Missing argument 'paths'" in ran.errors
    refused("no bag of a simulated flight given", "validate", MODEL)
    refused("no model folder given: name model folders, then bags", "validate", FLIGHT)
