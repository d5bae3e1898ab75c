# SPDX-FileCopyrightText: 2026 The quadpi authors
# SPDX-License-Identifier: Apache-2.0
"""What a run that is killed leaves is gone after the next one, and nothing of one that lives."""

from __future__ import annotations

import os
import signal
import subprocess
import sys
from pathlib import Path

import pytest

import quadpi_core
from quadpi_core import scratch
from quadpi_core.paths import whole_outputs
from quadpi_core.scratch import scratch_folder

OPENED = """
import sys, time
from pathlib import Path
from quadpi_core import paths, scratch
target = Path(sys.argv[1])
"""
# Each says "there" once its temporary folder is there, and waits.
RUNS = {
    "file": "with paths.whole_output(target / 'data.json') as path: path.write_text('half'); wait()",
    "folder": "with paths.whole_output(target / 'model') as path: path.mkdir(); wait()",
    "files": "with paths.whole_outputs(target) as path: (path / 'a').touch(); wait()",
    "other": """
with paths.whole_output(target / 'other') as path, scratch.scratch_folder():
    path.write_text('other')
print('there')
""",
    "system": "with scratch.scratch_folder() as path: wait()",
    "kernels": "from quadpi_core.compiled import njit; njit(cache=True)(wait); wait()",
    "domain": "from quadpi_ros.processes import isolated_domain\nwith isolated_domain() as path: wait()",
}


@pytest.fixture
def system(tmp_path, monkeypatch):
    """The folder for temporary files of the system."""
    folder = tmp_path / "system"
    folder.mkdir()
    monkeypatch.setattr("tempfile.tempdir", str(folder))
    return folder


@pytest.fixture
def run(tmp_path, system):
    """run(name) → a process that is at work, with its output in tmp_path/out."""
    started = []
    (tmp_path / "out").mkdir()

    def start(name):
        if name == "domain":
            pytest.importorskip("rclpy")
        file = tmp_path / "run.py"
        file.write_text(
            f"{OPENED}def wait():\n    print('there', flush=True)\n    time.sleep(600)\n{RUNS[name]}"
        )
        environment = {
            **{name: value for name, value in os.environ.items() if name != "NUMBA_CACHE_DIR"},
            "PYTHONPATH": str(Path(quadpi_core.__file__).parents[1]),
            "TMPDIR": str(system),
            # No folder: kernels are then cached for one process alone.
            "XDG_CACHE_HOME": str(file),
        }
        process = subprocess.Popen(
            [sys.executable, file, str(tmp_path / "out")], env=environment, stdout=subprocess.PIPE, text=True
        )
        started.append(process)
        assert process.stdout.readline() == "there\n"
        return process

    yield start
    for process in started:
        process.kill()
        process.communicate()


def leftovers(*folders):
    return [path for folder in folders for path in folder.glob(".quadpi.*")]


@pytest.mark.parametrize("name", [name for name in RUNS if name != "other"])
def test_the_next_run_clears_what_a_killed_one_left_and_not_before_it_is_killed(name, run, tmp_path, system):
    out, process = tmp_path / "out", run(name)
    (kept,) = leftovers(out, system)

    def next_run():
        run("other").wait()

    next_run()
    assert leftovers(out, system) == [kept]
    process.send_signal(signal.SIGKILL)
    process.wait()
    assert leftovers(out, system) == [kept]
    next_run()
    assert leftovers(out, system) == []
    assert [path.name for path in out.iterdir()] == ["other"]


def test_an_output_that_was_moved_away_is_put_back(tmp_path):
    """As a run leaves it that is killed after the old model went, and before the new one came."""
    left = tmp_path / ".quadpi.abcd_123"
    for name in ("made/model", "replaced"):
        (left / name).mkdir(parents=True)
        (left / name / "which").write_text(name)
    with whole_outputs(tmp_path) as path:
        (path / "a").touch()
    assert (tmp_path / "model" / "which").read_text() == "replaced"
    assert sorted(path.name for path in tmp_path.iterdir()) == ["a", "model"]


def test_an_output_that_is_there_is_not_replaced_by_an_older_one(tmp_path):
    left = tmp_path / ".quadpi.abcd_123"
    for name in ("made", "replaced"):
        (left / name).mkdir(parents=True)
    (left / "made" / "model").mkdir()
    (tmp_path / "model").mkdir()
    (tmp_path / "model" / "new").touch()
    with scratch_folder(tmp_path):
        pass
    assert [path.name for path in tmp_path.rglob("*")] == ["model", "new"]


def test_what_only_looks_alike_stays(tmp_path):
    (tmp_path / "elsewhere").mkdir()
    (tmp_path / "elsewhere" / "mine").touch()
    (tmp_path / ".quadpi.abcd_123").symlink_to(tmp_path / "elsewhere")
    (tmp_path / ".quadpi.abcd_124").write_text("a file")
    for name in (".quadpi.settings", ".quadpi.d"):
        (tmp_path / name).mkdir()
        (tmp_path / name / "mine").touch()
    before = sorted(tmp_path.rglob("*"))
    with scratch_folder(tmp_path) as folder:
        assert folder.is_dir()
    assert sorted(tmp_path.rglob("*")) == before


def test_a_folder_of_another_user_stays(tmp_path, monkeypatch):
    """Also for who may remove it: its owner could put a link in its place meanwhile."""
    (tmp_path / ".quadpi.abcd_123").mkdir()
    own = os.geteuid()
    monkeypatch.setattr(scratch.os, "geteuid", lambda: own + 1)
    with scratch_folder(tmp_path):
        pass
    assert [path.name for path in tmp_path.iterdir()] == [".quadpi.abcd_123"]


def test_a_file_system_without_locks_is_left_alone(tmp_path, monkeypatch):
    def refuse(*_):
        raise OSError("no locks available")

    monkeypatch.setattr(scratch.fcntl, "flock", refuse)
    (tmp_path / ".quadpi.abcd_123").mkdir()
    with scratch_folder(tmp_path) as folder:
        assert folder.is_dir()
    assert not folder.exists()
    assert (tmp_path / ".quadpi.abcd_123").is_dir()


def test_a_folder_that_is_cleared_before_it_is_locked_is_made_again(tmp_path, monkeypatch):
    open_file, made = os.open, []

    def cleared(path, *options):
        made.append(path.parent)
        if len(made) == 1:
            path.parent.rmdir()
        return open_file(path, *options)

    monkeypatch.setattr(scratch.os, "open", cleared)
    with scratch_folder(tmp_path) as folder:
        assert folder == made[1]
        monkeypatch.undo()
    assert list(tmp_path.iterdir()) == []


def test_an_interruption_while_it_is_made_leaves_nothing(tmp_path, monkeypatch):
    def interrupt(*_):
        assert len(list(tmp_path.iterdir())) == 1
        raise KeyboardInterrupt

    monkeypatch.setattr(scratch.fcntl, "flock", interrupt)
    with pytest.raises(KeyboardInterrupt), scratch_folder(tmp_path):
        pass
    assert list(tmp_path.iterdir()) == []


def test_a_signal_during_the_removal_leaves_nothing(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    remove, calls = scratch.shutil.rmtree, []

    def interrupted(folder: Path, ignore_errors: bool) -> None:
        calls.append(folder)
        if len(calls) == 1:
            raise KeyboardInterrupt
        remove(folder, ignore_errors=ignore_errors)

    monkeypatch.setattr(scratch.shutil, "rmtree", interrupted)
    with pytest.raises(KeyboardInterrupt), scratch_folder(tmp_path):
        pass
    assert list(tmp_path.iterdir()) == []
