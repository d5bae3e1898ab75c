# SPDX-FileCopyrightText: 2026 The quadpi authors
# SPDX-License-Identifier: Apache-2.0
"""Many logs to bags: the same bytes whatever does the work, and all bags or none."""

from __future__ import annotations

import shutil
from dataclasses import replace
from pathlib import Path

import pytest

from quadpi_core.errors import LogError, OutputError
from quadpi_core.logs.importing import import_logs
from quadpi_core.parallel import Workers
from quadpi_core.paths import config_directory, staged, whole_outputs
from quadpi_core.vehicle import Vehicle


@pytest.fixture(scope="module")
def vehicle():
    return Vehicle.load("neurobem")


def contents(folder):
    return {path: path.read_bytes() if path.is_file() else None for path in folder.rglob("*")}


def test_bags_replace_those_of_the_same_name_only(bags, vehicle, tmp_path):
    (tmp_path / "flight0.mcap").write_text("old")
    (tmp_path / "notes.txt").write_text("mine")
    counts = []
    imported = import_logs(bags, vehicle, tmp_path, workers=Workers(progress=counts.append))
    assert [one.bag for one in imported] == [tmp_path / bag.name for bag in bags]
    assert imported[0].imu_samples == 3200
    assert imported[0].topics == ("imu", "rotor_speeds", "mocap/pose")
    assert imported[0].alignments == {}
    assert sorted(path.name for path in tmp_path.iterdir()) == [*(bag.name for bag in bags), "notes.txt"]
    assert (tmp_path / "flight0.mcap").read_bytes()[:5] == b"\x89MCAP"
    assert (tmp_path / "notes.txt").read_text() == "mine"
    assert [progress.done for progress in counts] == [1, 2, 3]


def test_folders_above_are_made(bags, vehicle, tmp_path):
    import_logs(bags[:1], vehicle, tmp_path / "some" / "where")
    assert [path.name for path in (tmp_path / "some" / "where").iterdir()] == ["flight0.mcap"]


@pytest.mark.slow
def test_a_cluster_writes_the_same_bytes(bags, vehicle, cluster, tmp_path, monkeypatch):
    """Workers have another working folder."""
    own = import_logs(bags, vehicle, tmp_path / "own", align=True)
    monkeypatch.chdir(tmp_path)
    theirs = import_logs(
        bags,
        vehicle,
        (tmp_path / "theirs").relative_to(tmp_path),
        align=True,
        workers=Workers(scheduler=cluster),
    )
    assert [replace(flight, bag=Path(flight.bag.name)) for flight in theirs] == [
        replace(flight, bag=Path(flight.bag.name)) for flight in own
    ]
    for one, other in zip(own, theirs, strict=True):
        assert one.bag.read_bytes() == other.bag.read_bytes()
    assert len(list(tmp_path.rglob("*"))) == 2 + 2 * len(bags)


@pytest.mark.slow
def test_a_cluster_finds_the_mapping(vehicle, cluster, tmp_path, monkeypatch):
    """And of a bad log says which it is; nothing is left behind."""
    monkeypatch.chdir(tmp_path)
    shutil.copy(config_directory() / "mappings" / "nanodrone.yaml", "mine.yaml")
    (tmp_path / "flight.csv").write_text("t\n0\n")
    before = contents(tmp_path)
    log = tmp_path.joinpath("flight.csv").relative_to(tmp_path)
    with pytest.raises(LogError, match=rf"^{tmp_path}/flight.csv: .*column"):
        import_logs([log], vehicle, tmp_path / "bags", "mine.yaml", workers=Workers(scheduler=cluster))
    assert contents(tmp_path) == before


@pytest.mark.slow
@pytest.mark.parametrize("place", ["here", "cluster"])
def test_one_bad_log_leaves_nothing(bags, vehicle, tmp_path, place, request):
    scheduler = request.getfixturevalue("cluster") if place == "cluster" else None
    bad = tmp_path / "bad.mcap"
    bad.write_bytes(bags[0].read_bytes()[:-8])
    (tmp_path / "bags").mkdir()
    (tmp_path / "bags" / "flight0.mcap").write_text("old")
    before = contents(tmp_path)
    with pytest.raises(LogError, match=f"^{bad}: cut off"):
        import_logs([*bags, bad], vehicle, tmp_path / "bags", workers=Workers(scheduler=scheduler))
    assert contents(tmp_path) == before


def test_logs_of_one_name_and_the_others_of_a_batch_with_bad_ones(bags, vehicle, tmp_path):
    """A copy has no bag, though it was converted before it was known to be one."""
    other, copy, bad = (tmp_path / name / "flight0.mcap" for name in ("other", "copy", "bad"))
    for path, source in ((other, bags[1]), (copy, bags[0]), (bad, None)):
        path.parent.mkdir()
        path.write_bytes(b"" if source is None else source.read_bytes())
    left_out = []
    imported = import_logs([bags[0], bad, other, copy], vehicle, tmp_path / "bags", left_out=left_out)
    names = [f"{path.parent.name}_flight0.mcap" for path in (bags[0], other)]
    assert [(flight.log, flight.bag.name) for flight in imported] == list(
        zip((bags[0], other), names, strict=True)
    )
    assert sorted(path.name for path in (tmp_path / "bags").iterdir()) == sorted(names)
    assert [(flight.flight, flight.reason) for flight in left_out] == [
        ("bad_flight0", f"{bad}: the file is empty"),
        ("copy_flight0", f"{copy}: the same flight as {bags[0]}; give each flight once"),
    ]


def test_a_bag_in_the_place_of_a_log(bags, vehicle):
    with pytest.raises(LogError, match=r"its bag would replace .*; choose another folder"):
        import_logs(bags, vehicle, bags[0].parent)


def test_a_folder_in_the_place_of_a_bag(bags, vehicle, tmp_path):
    (tmp_path / "flight1.mcap").mkdir()
    before = contents(tmp_path)
    with pytest.raises(OutputError, match=f"^{tmp_path}/flight1.mcap: cannot be written: Is a directory"):
        import_logs(bags, vehicle, tmp_path)
    assert contents(tmp_path) == before


def test_a_worker_that_outlives_its_run_writes_nothing(tmp_path):
    with whole_outputs(tmp_path / "bags") as staging:
        assert staged(staging, "a.mcap") == staging / "a.mcap"
    with pytest.raises(OutputError, match=r"a\.mcap: not written: the run .* has ended"):
        staged(staging, "a.mcap")
