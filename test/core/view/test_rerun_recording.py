# SPDX-FileCopyrightText: 2026 The quadpi authors
# SPDX-License-Identifier: Apache-2.0
"""A recording of Rerun holds the flight and its results, at full rate and by their stamps."""

from __future__ import annotations

from collections import defaultdict
from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from quadpi_core.flight import AXES, OdometryStream, RotorSpeedStream
from quadpi_core.inputs import INPUT_NAMES
from quadpi_core.messages.result_messages import DescribedModel
from quadpi_core.monitor.change import found_columns, nothing_found
from quadpi_core.results import ACTIVE, AlarmEvent, Predictions, ReportedAlarms
from quadpi_core.view.flight_parts import Part
from quadpi_core.view.rerun_recording import RATE_HZ, TIMELINE, extremes, write_rerun_file

rerun = pytest.importorskip("rerun", reason="Rerun is not installed: extra `rerun`")
chunks = pytest.importorskip("rerun.chunk", reason="this Rerun does not read its files")

START_NS = 1_700_000_000_123_456_789
STAMPS = START_NS + 2_000_000 * np.arange(100)
RNG = np.random.default_rng(5)
MEASURED = RNG.standard_normal((100, 6))


def predictions(shift: float) -> Predictions:
    return Predictions(STAMPS, MEASURED + shift, MEASURED - 1.0, MEASURED + 1.0, MEASURED, np.ones((100, 6)))


def alarms() -> ReportedAlarms:
    count = 3
    by_axis = {name: np.zeros((count, 6)) for name in ("leverage", "width", "miscoverage", "miss_share")}
    return ReportedAlarms(
        time_ns=STAMPS[:3],
        level=np.array([0, 2, 2], dtype=np.uint8),
        causes=np.array([0, 1, 1], dtype=np.uint8),
        cause_level=np.zeros((count, 4), dtype=np.uint8),
        cause_health=np.full((count, 4), ACTIVE, dtype=np.uint8),
        cause_evidence=np.zeros((count, 4)),
        envelope_distance=np.array([0.0, 0.5, 0.25]),
        inputs_outside=[(), ("u",), ("u",)],
        reasons=[
            (),
            ("forward or backward speed 1.4 x the training range",),
            ("forward or backward speed 1.4 x the training range",),
        ],
        **by_axis,
        **found_columns(nothing_found(count), None),
    )


INPUTS = RNG.standard_normal((100, len(INPUT_NAMES)))
KNOWN = {
    "one@1": DescribedModel(
        "one@1", "bebop2", np.full(len(INPUT_NAMES), -2.0), np.full(len(INPUT_NAMES), 3.0)
    )
}
ATTITUDE = np.tile([1.0, 0.0, 0.0, 0.0], (100, 1))
POSITION = np.column_stack((np.linspace(0.0, 5.0, 100), np.ones(100), np.full(100, -2.0)))
VELOCITY = np.tile([3.0, 0.0, 4.0], (100, 1))
SPEEDS = 700.0 + RNG.standard_normal((100, 6))


def parts() -> Iterator[Part]:
    def results(taker: Any) -> None:
        taker.take_predictions("one", predictions(0.1), "one@1", 0.95, ("Fx", "Mz"))
        taker.take_predictions("two", predictions(0.2), "two@2", 0.95, AXES)
        taker.take_inputs(STAMPS, INPUTS)

    def motion(taker: Any) -> None:
        taker.take_states(OdometryStream(STAMPS, POSITION, ATTITUDE, VELOCITY, np.zeros((100, 3))))
        taker.take_rotor_speeds(RotorSpeedStream(STAMPS, SPEEDS))

    def alarm(taker: Any) -> None:
        raised = AlarmEvent(
            1,
            1,
            int(STAMPS[1]),
            int(STAMPS[1]),
            0,
            2.0,
            ("forward or backward speed 1.4 x the training range",),
        )
        taker.take_alarms(alarms())
        taker.take_events([raised, replace(raised, time_ns=int(STAMPS[9]), end_ns=int(STAMPS[9]))])

    yield from (results, motion, alarm)


class Recording:
    """What a file holds: (stamps, values) of every component of every entity."""

    def __init__(self, file: Path) -> None:
        self.temporal: dict[str, dict[str, list[tuple[int, Any]]]] = defaultdict(lambda: defaultdict(list))
        self.static: dict[str, dict[str, Any]] = defaultdict(dict)
        for chunk in chunks.RrdReader(str(file)).stream():
            batch = chunk.to_record_batch()
            stamps = batch[TIMELINE].cast("int64").to_pylist() if TIMELINE in batch.schema.names else None
            for name in batch.schema.names:
                if ":" not in name:
                    continue
                values = batch[name].to_pylist()
                component = name.rpartition(":")[2]
                if chunk.is_static:
                    self.static[chunk.entity_path][component] = values[0]
                else:
                    assert stamps is not None
                    self.temporal[chunk.entity_path][component] += list(zip(stamps, values, strict=True))

    def series(self, entity: str) -> tuple[np.ndarray, np.ndarray]:
        stamps, values = zip(*sorted(self.temporal[f"/{entity}"]["scalars"]), strict=True)
        return np.array(stamps), np.array(values)


@pytest.fixture(scope="module")
def recording(tmp_path_factory: pytest.TempPathFactory) -> Recording:
    file = tmp_path_factory.mktemp("rerun") / "flight.rrd"
    # Of 500 Hz every sample.
    write_rerun_file(parts(), file, KNOWN, 1000.0)
    return Recording(file)


def test_wrench_and_bands_of_the_first_model_and_of_further_ones(recording: Recording) -> None:
    for column, axis in ((0, "Fx"), (5, "Mz")):
        measured = MEASURED[:, column]
        stamps, values = recording.series(f"wrench/{axis}")
        np.testing.assert_array_equal(stamps, STAMPS)
        np.testing.assert_array_equal(
            values, np.column_stack((measured, measured + 0.1, measured - 1.0, measured + 1.0))
        )
        _, other = recording.series(f"wrench/{axis}/two")
        np.testing.assert_array_equal(other[:, 0], measured + 0.2)
        assert recording.static[f"/wrench/{axis}"]["names"] == [
            "measured",
            "predicted",
            "lower 95%",
            "upper 95%",
        ]
    # An axis that a model does not hold is not drawn.
    assert "/wrench/Fy" not in recording.temporal
    assert "/wrench/Fy/two" in recording.temporal


def test_inputs_with_their_training_range(recording: Recording) -> None:
    for column, name in enumerate(INPUT_NAMES):
        _, values = recording.series(f"inputs/{name}")
        np.testing.assert_array_equal(values[:, 0], INPUTS[:, column])
        assert (values[:, 1:] == [-2.0, 3.0]).all()


def test_motion_is_in_the_world_east_north_up(recording: Recording) -> None:
    vehicle = recording.temporal["/flight/vehicle"]
    positions = [value[0] for _, value in sorted(vehicle["translation"])]
    np.testing.assert_allclose(positions, np.column_stack((np.ones(100), POSITION[:, 0], np.full(100, 2.0))))
    # Nose to the north, level: turned by 90 degrees about the vertical from the east. Order x y z w.
    quaternion = np.array(vehicle["quaternion"][0][1][0])
    np.testing.assert_allclose(quaternion * np.sign(quaternion[3]), [0.0, 0.0, 0.5**0.5, 0.5**0.5], atol=1e-6)
    (trail,) = recording.static["/flight/trail"]["strips"]
    np.testing.assert_allclose(trail[0], [1.0, 0.0, 2.0])
    assert len(trail) == 4  # 0.2 s, a point every 50 ms
    _, speed = recording.series("speed")
    np.testing.assert_allclose(speed, 5.0)
    _, rotors = recording.series("rotor_speeds")
    np.testing.assert_array_equal(rotors, SPEEDS)


def test_alarm_as_series_and_as_words_where_they_change(recording: Recording) -> None:
    stamps, levels = recording.series("alarm/level")
    assert list(zip(stamps, levels[:, 0], strict=True)) == list(zip(STAMPS[:3], (0, 2, 2), strict=True))
    assert recording.series("alarm/envelope_distance")[1][:, 0].tolist() == [0.0, 0.5, 0.25]
    log = recording.temporal["/alarm/log"]
    assert [(stamp, value[0]) for stamp, value in sorted(log["text"])] == [
        (STAMPS[0], "TRUSTED"),
        (STAMPS[1], "ALARM: forward or backward speed 1.4 x the training range"),
        (STAMPS[1], "alarm 1 raised: extrapolation"),
        (STAMPS[9], "alarm 1 cleared: extrapolation"),
    ]
    assert [value[0] for _, value in sorted(log["level"])] == ["INFO", "ERROR", "ERROR", "INFO"]


def test_an_hour_has_few_rows_and_every_extreme() -> None:
    time_ns = np.arange(5000) * 2_000_000
    values = np.random.default_rng(3).normal(size=(5000, 2))
    values[1234, 0], values[4321, 1] = 50.0, -60.0
    chosen_ns, rows = extremes(time_ns, values, round(2e9 / RATE_HZ))
    assert 400 <= len(rows) <= 10 * 50, "50 rows a second, 10 s"
    assert (np.diff(chosen_ns) > 0).all()
    for stretch in range(250):
        inside = time_ns // 40_000_000 == stretch
        kept = rows[chosen_ns // 40_000_000 == stretch]
        np.testing.assert_array_equal(kept.min(axis=0), values[inside].min(axis=0))
        np.testing.assert_array_equal(kept.max(axis=0), values[inside].max(axis=0))


def test_what_falls_still_falls_and_gaps_stay_gaps() -> None:
    time_ns = np.arange(100) * 2_000_000
    falling = np.column_stack((-np.arange(100.0), np.full(100, np.nan)))
    _, rows = extremes(time_ns, falling, 40_000_000)
    assert (np.diff(rows[:, 0]) < 0).all()
    assert np.isnan(rows[:, 1]).all()


def test_few_samples_are_left_as_they_are() -> None:
    time_ns, values = np.arange(7) * 20_000_000, np.arange(7.0)[:, None]
    chosen_ns, rows = extremes(time_ns, values, 40_000_000)
    np.testing.assert_array_equal(chosen_ns, time_ns)
    np.testing.assert_array_equal(rows, values)


def test_what_the_flight_lacks_is_given_back(tmp_path: Path) -> None:
    lacks = ("odometry", "flight, speed and height are not shown")

    def lacking() -> Iterator[Part]:
        yield from parts()
        yield lambda view: view.take_missing([lacks])

    assert write_rerun_file(lacking(), tmp_path / "flight.rrd", KNOWN) == [lacks]


def test_no_rate_is_too_high(tmp_path: Path) -> None:
    file = tmp_path / "flight.rrd"
    write_rerun_file(parts(), file, KNOWN, float("inf"))
    stamps, _ = Recording(file).series("wrench/Fx")
    np.testing.assert_array_equal(stamps, STAMPS)


def test_an_error_on_the_way_leaves_no_file(tmp_path: Path) -> None:
    def broken() -> Iterator[Part]:
        yield from parts()
        raise RuntimeError("the disk is gone")

    file = tmp_path / "flight.rrd"
    file.write_text("before")
    with pytest.raises(RuntimeError, match="the disk is gone"):
        write_rerun_file(broken(), file, KNOWN)
    assert file.read_text() == "before"
    assert [path.name for path in tmp_path.iterdir()] == ["flight.rrd"]
