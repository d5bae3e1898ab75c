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
    assert imported[0].alignment is None
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


def test_two_logs_of_one_name(bags, vehicle, tmp_path):
    other = shutil.copy(bags[1], tmp_path / "flight0.mcap")
    with pytest.raises(LogError, match=f"^{other}: would be written to the same bag as {bags[0]}$"):
        import_logs([bags[0], other], vehicle, tmp_path / "bags")
    assert not (tmp_path / "bags").exists()


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
