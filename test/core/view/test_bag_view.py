# SPDX-FileCopyrightText: 2026 The quadpi authors
# SPDX-License-Identifier: Apache-2.0
"""A bag as the page gets it: judged here, or with the results that it holds."""

from __future__ import annotations

import threading
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from quadpi_core.errors import LogError, ModelError, QuadpiError
from quadpi_core.logs.bag_files import Bag
from quadpi_core.logs.bag_writer import write_mcap
from quadpi_core.logs.bags import read_outputs
from quadpi_core.messages.payloads import Payloads
from quadpi_core.messages.result_messages import unpack_model
from quadpi_core.vehicle import Vehicle
from quadpi_core.view.rerun_recording import open_bag
from quadpi_core.view.trust import State

from .conftest import BAG, read_whole


def test_a_judged_bag_shows_what_replay_writes(judged_view, results_bag):
    predictions, alarms = read_outputs(results_bag)
    start_ns = predictions.time_ns[0]
    numbers = (predictions.time_ns - start_ns) // judged_view.blocks.block_ns
    for block in (0, 17, 200, judged_view.blocks.newest):
        inside = numbers == block
        assert judged_view.blocks.value(block, "0.count")[0] == inside.sum()
        for name, values in (
            ("measured", predictions.measured),
            ("0.lower", predictions.lower),
            ("0.predicted", predictions.predicted),
        ):
            np.testing.assert_allclose(judged_view.blocks.value(block, name), values[inside][-1], rtol=1e-6)
        missed = (predictions.measured < predictions.lower) | (predictions.measured > predictions.upper)
        np.testing.assert_array_equal(judged_view.blocks.value(block, "0.misses"), missed[inside].sum(axis=0))
    assert alarms.level.max() == 2
    assert str(int(State.ALARM)) in judged_view.timeline.codes


def test_a_flight_of_training_is_known_by_what_it_holds(judged_view, model, vehicle, tmp_path):
    copy = tmp_path / "renamed.mcap"
    copy.write_bytes((BAG.parent / "train_2.mcap").read_bytes())
    rows = read_whole(open_bag(copy, [model], vehicle)).overview()["health"]
    assert [row[2] for row in rows] == [f"in sample: {model.name} was identified on this flight"]
    assert judged_view.overview()["health"] == []


def test_a_bag_of_results_shows_the_same_without_a_model(judged_view, results_bag):
    recorded = read_whole(open_bag(results_bag, [], None))
    assert recorded.timeline.codes == judged_view.timeline.codes
    assert recorded.describe()["models"][0]["identity"] == judged_view.describe()["models"][0]["identity"]
    for name in ("measured", "0.upper", "speed", "position"):
        np.testing.assert_allclose(
            recorded.blocks.value(300, name), judged_view.blocks.value(300, name), rtol=1e-5, atol=1e-6
        )
    assert np.isnan(recorded.blocks.value(300, "inputs")).all()


def without(source: Path, target: Path, *left_out: str) -> Path:
    """A bag of results that lacks topics."""
    with Bag(source) as bag:
        topics = bag.read([connection.topic for connection in bag.connections])
    write_mcap(target, [topic for name, topic in topics.items() if name.strip("/") not in left_out], {})
    return target


def test_a_recorded_bag_shows_all_its_models(results_bag, tmp_path):
    with Bag(results_bag) as bag:
        topics = list(bag.read([connection.topic for connection in bag.connections]).values())
    prediction = next(topic for topic in topics if topic.name == "/prediction")
    payloads = prediction.payloads
    identity = unpack_model(payloads[0]).identity
    other = identity.replace("model@", "other@")
    second = Payloads.join([payload.replace(identity.encode(), other.encode()) for payload in payloads])
    topics.append(replace(prediction, name="/prediction/other", payloads=second))
    write_mcap(tmp_path / "two.mcap", topics, {})
    view = read_whole(open_bag(tmp_path / "two.mcap", [], None))
    assert [one["identity"] for one in view.describe()["models"]] == [identity, other]
    np.testing.assert_array_equal(view.blocks.value(100, "1.upper"), view.blocks.value(100, "0.upper"))


def test_topics_that_a_bag_lacks_are_named(results_bag, tmp_path):
    bag = without(results_bag, tmp_path / "few.mcap", "odometry", "extrapolation_alarm")
    rows = read_whole(open_bag(bag, [], None)).overview()["health"]
    assert [(about, level) for about, level, _ in rows] == [
        ("extrapolation_alarm", "warn"),
        ("odometry", "warn"),
        ("rotor_speeds", "warn"),
    ]
    assert rows[1][2] == "the bag has no topic odometry: flight, speed and height are not shown"


@pytest.mark.parametrize("name", ["bebop2", "", "nobody"])
def test_electrical_speeds_are_shown_where_the_bag_names_its_vehicle(results_bag, tmp_path, name):
    with Bag(BAG) as flown:
        erpm = flown.read(["/erpm"])["/erpm"]
    with Bag(results_bag) as bag:
        topics = list(bag.read([connection.topic for connection in bag.connections]).values())
    write_mcap(tmp_path / "erpm.mcap", [*topics, erpm], {"vehicle": name})
    view = read_whole(open_bag(tmp_path / "erpm.mcap", [], None))
    rows = view.overview()["health"]
    if name == "bebop2":
        assert rows == []
        assert view.blocks.value(100, "rotors")[0] > 100.0
    else:
        about, _, text = rows[-1]
        assert about == "erpm"
        assert (name or "does not name its vehicle") in text


def test_several_models_side_by_side(model, vehicle, judged_view):
    second = replace(model, name="second", identity="second@1")
    both = read_whole(open_bag(BAG, [model, second], vehicle))
    assert [one["name"] for one in both.describe()["models"]] == [model.name, "second"]
    np.testing.assert_array_equal(both.blocks.value(100, "1.upper"), judged_view.blocks.value(100, "0.upper"))


def test_models_of_one_name_are_refused(model, vehicle):
    with pytest.raises(QuadpiError, match="--model: two models have the same name"):
        open_bag(BAG, [model, model], vehicle)


def test_a_bag_without_predictions_says_how_to_get_them():
    with pytest.raises(LogError, match=r"holds no predictions; judge it by a model: quadpi view .* --model"):
        open_bag(BAG, [], None)


def test_a_model_of_another_vehicle_is_refused(model):
    with pytest.raises(ModelError, match="is of vehicle bebop2, not neurobem"):
        open_bag(BAG, [model], Vehicle.load("neurobem"))


def test_closing_ends_the_reader_at_once(model, vehicle):
    source = open_bag(BAG, [model], vehicle)
    source.close()
    assert "bag reader" not in {thread.name for thread in threading.enumerate()}


def test_a_bag_that_cannot_be_read_further_shows_what_was_read_and_says_so(model, vehicle, monkeypatch):
    from quadpi_core.view import flight_parts

    whole = flight_parts.judged

    def cut(*arguments):
        for number, part in enumerate(whole(*arguments)):
            if number == 2:
                raise LogError("flight.mcap: damaged")
            yield part

    monkeypatch.setattr(flight_parts, "judged", cut)
    source = open_bag(BAG, [model], vehicle)
    with pytest.raises(LogError, match="damaged"):
        read_whole(source)
    (view,) = source.vehicles.values()
    assert view.blocks.newest > 0
    assert view.summary()["state"] == State.NO_DATA
    assert view.overview()["health"] == [("bag", "error", "flight.mcap: damaged")]
