# SPDX-FileCopyrightText: 2026 The quadpi authors
# SPDX-License-Identifier: Apache-2.0
"""What pip and colcon install is what the checkout holds."""

from __future__ import annotations

import ast
import os
import re
import shutil
import subprocess
import sys
from importlib.metadata import packages_distributions
from pathlib import Path
from xml.etree import ElementTree

import pytest
import yaml

ROOT = Path(__file__).resolve().parents[1]
PACKAGES = ("quadpi_core", "quadpi_ros")
SHARED = ("bags", "config", "launch", "msg", "srv")
PROGRAMS = "programs"
BUILD_FILES = ("core", "setup.py", "pyproject.toml", "package.xml", "README.md", "LICENSE", "resource")
# In the place of CMake, whose build by setup.py made the module that these tests import.
COPIED = """#!/bin/sh
for given; do
    case $given in -DQUADPI_MODULE_FOLDER=*) mkdir -p "${given#*=}" && cp "$MODULE" "${given#*=}" ;; esac
done
"""


def files(folder: Path) -> set[str]:
    """Everything below a folder by its path there, without what Python leaves behind."""
    return {
        str(path.relative_to(folder))
        for path in folder.rglob("*")
        if path.is_file() and path.parent.name != "__pycache__"
    }


@pytest.mark.slow
def test_wheel_holds_every_module_and_every_shared_file(tmp_path: Path) -> None:
    source = tmp_path / "source"
    source.mkdir()
    for name in (*PACKAGES, *SHARED, PROGRAMS, *BUILD_FILES):
        copy = shutil.copytree if (ROOT / name).is_dir() else shutil.copy
        copy(ROOT / name, source / name)
    pip = (sys.executable, "-m", "pip", "--disable-pip-version-check", "--quiet")
    build = ("wheel", "--no-deps", "--no-build-isolation", "--wheel-dir", str(tmp_path), str(source))
    cmake = tmp_path / "programs" / "cmake"
    cmake.parent.mkdir()
    cmake.write_text(COPIED)
    cmake.chmod(0o755)
    (module,) = (ROOT / "quadpi_core").glob("_core.*.so")
    given = {"PATH": f"{cmake.parent}{os.pathsep}{os.environ['PATH']}", "MODULE": str(module)}
    subprocess.run([*pip, *build], check=True, env=os.environ | given)
    (wheel,) = tmp_path.glob("*.whl")
    prefix = tmp_path / "prefix"
    install = (
        "install",
        "--ignore-installed",
        "--no-deps",
        "--prefix",
        str(prefix),
        "--root",
        "/",
        str(wheel),
    )
    subprocess.run([*pip, *install], check=True)
    (packages,) = prefix.glob("lib/python*/site-packages")
    for package in PACKAGES:
        assert files(ROOT / package) == files(packages / package)
    assert_complete(prefix)
    assert (prefix / "bin" / "quadpi").is_file()


@pytest.fixture
def prefix(monkeypatch: pytest.MonkeyPatch) -> Path:
    """Where CMake has installed quadpi: that of a sourced workspace, or the environment of these tests."""
    ament = pytest.importorskip("ament_index_python.packages", reason="ROS 2 is not installed")
    monkeypatch.setenv("AMENT_PREFIX_PATH", sys.prefix, prepend=os.pathsep)
    return Path(ament.get_package_prefix("quadpi"))


def test_environment_is_a_whole_ros_package(prefix: Path) -> None:
    assert_complete(prefix)


def assert_complete(prefix: Path) -> None:
    """`ros2 launch`, `ros2 run` and `ros2 pkg` find in a prefix all that the checkout holds."""
    share = prefix / "share" / "quadpi"
    assert (prefix / "share" / "ament_index" / "resource_index" / "packages" / "quadpi").is_file()
    assert (share / "package.xml").read_bytes() == (ROOT / "package.xml").read_bytes()
    for folder in SHARED:
        assert files(ROOT / folder) <= files(share / folder), folder
    # As `ros2 launch` looks for them: without following links to folders.
    walked = {name for _, _, names in os.walk(share) for name in names}
    assert {path.name for path in (ROOT / "launch").glob("*.launch.py")} <= walked
    programs = prefix / "lib" / "quadpi"
    assert files(ROOT / PROGRAMS) == files(programs)
    assert all(os.access(programs / name, os.X_OK) for name in files(programs))


def test_every_node_is_a_program() -> None:
    modules = {path.stem for path in (ROOT / "quadpi_ros").glob("*.py") if "\ndef main()" in path.read_text()}
    started = [
        re.search(r"-m quadpi_ros\.(\w+)", path.read_text())[1] for path in (ROOT / PROGRAMS).iterdir()
    ]
    assert sorted(started) == sorted(modules)


def test_programs_differ_by_their_module_alone() -> None:
    """So what one of them is found to do, all do."""
    texts = [path.read_text() for path in (ROOT / PROGRAMS).iterdir()]
    assert len({re.sub(r"-m quadpi_ros\.\w+ ", "-m quadpi_ros.MODULE ", text) for text in texts}) == 1


def test_a_program_runs_with_no_environment_active(prefix: Path) -> None:
    if not (prefix / "bin" / "python3").exists():
        pytest.skip(f"{prefix}: a workspace, whose programs need its environment")
    result = subprocess.run(
        [prefix / "lib" / "quadpi" / "monitor_node", "--ros-args", "--log-level", "loud"],
        env={"PATH": os.defpath},
        capture_output=True,
        text=True,
        check=False,
    )
    assert result.returncode == 2, result.stderr
    assert "loud" in result.stderr
    assert "Traceback" not in result.stderr


# Imported only where an extra of pyproject.toml is asked for, or what it tests with.
OPTIONAL = {"latex2mathml", "matplotlib", "pandas", "pyarrow", "sklearn", "torch"}
# These come with typer, and with rosbags in the versions that it works with.
COME_WITH_OTHERS = {"backports", "lz4", "rich", "ruamel"}
# Most that users must install.
REQUIRED_MAX = 10
# Needed by the messages, or found by its name where it is installed; not imported.
NOT_IMPORTED = {"rosidl_default_runtime", "tf2_msgs"}


def imported() -> set[str]:
    """The packages that the code and the launch files import, without what Python and quadpi bring."""
    folders = (*PACKAGES, "launch")
    modules = set()
    for file in [file for folder in folders for file in (ROOT / folder).rglob("*.py")]:
        for node in ast.walk(ast.parse(file.read_text())):
            if isinstance(node, ast.Import):
                modules |= {name.name.partition(".")[0] for name in node.names}
            if isinstance(node, ast.ImportFrom) and node.module and not node.level:
                modules.add(node.module.partition(".")[0])
    return modules - set(sys.stdlib_module_names) - {*PACKAGES, "quadpi"}


def test_what_is_imported_is_declared() -> None:
    """In pyproject.toml what pip has; in package.xml what live nodes import, see test_live_imports.py."""
    package = ElementTree.parse(ROOT / "package.xml")
    declared = {item.text for tag in ("depend", "exec_depend") for item in package.iter(tag)} - NOT_IMPORTED
    table = re.search(r"^dependencies = \[\n([^]]*)", (ROOT / "pyproject.toml").read_text(), re.MULTILINE)
    line = re.search(r"^ +pip install ([a-z].*)$", (ROOT / "README.md").read_text(), re.MULTILINE)
    assert table is not None
    assert line is not None
    required = set(re.findall(r'"([\w.]+)>=', table[1]))

    distributions = packages_distributions()
    modules = imported() - OPTIONAL - COME_WITH_OTHERS
    ros = {module for module in modules if module in declared}
    assert {distributions.get(module, [module])[0].lower() for module in modules - ros} == required
    assert len(required) <= REQUIRED_MAX
    system = {name.removeprefix("python3-") for name in declared - ros}
    assert declared - ros == {f"python3-{name}" for name in system}
    by_pip = set(re.findall(r"[a-z][a-z0-9]+(?:\.[a-z]+)?", line[1]))
    assert by_pip == required - system - {"pyyaml"}


def test_maintainer_can_be_reached() -> None:
    """catkin_pkg refuses what is no address, and the domain must not be one that is reserved for examples."""
    maintainer = ElementTree.parse(ROOT / "package.xml").find("maintainer")
    assert maintainer is not None
    address = maintainer.get("email", "")
    assert re.fullmatch(r"[\w.+-]+@[\w-]+(\.[\w-]+)*\.[a-z]+", address)
    assert address.rpartition(".")[2] not in {"example", "invalid", "localhost", "test"}
    assert pytest.importorskip("catkin_pkg.package").parse_package(str(ROOT / "package.xml")).name == "quadpi"


def test_the_workflow_runs_what_ci_runs() -> None:
    workflow = yaml.safe_load((ROOT / ".github" / "workflows" / "ci.yml").read_text())
    (job,) = workflow["jobs"].values()
    assert [step["run"] for step in job["steps"] if "run" in step] == [".ci/run"]
    supported = re.search(
        r"^requires-python = \">=(3\.\d+),<3\.(\d+)\"$", (ROOT / "pyproject.toml").read_text(), re.MULTILINE
    )
    assert supported is not None
    assert job["strategy"]["matrix"]["python"] == [supported[1], f"3.{int(supported[2]) - 1}"]
