# SPDX-FileCopyrightText: 2026 The quadpi authors
# SPDX-License-Identifier: Apache-2.0
"""Live nodes and launch files import only what a rosdep key of package.xml provides: no package of pip."""

from __future__ import annotations

import json
import os
import subprocess
import sys
from importlib.metadata import packages_distributions
from pathlib import Path
from xml.etree import ElementTree

import pytest

from . import imports_child

ROOT = Path(__file__).parents[2]
# Distributions of the keys of package.xml that are Python packages, with what these depend on.
OF_KEYS = {
    "python3-numpy": {"numpy"},
    "python3-scipy": {"scipy"},
    "python3-tornado": {"tornado"},
    "python3-yaml": {"PyYAML"},
}
# quadpi by pip, and as colcon installs its packages.
OF_QUADPI = {"quadpi-monitor", "quadpi_core", "quadpi_ros"}
# Of rclpy and rosidl.
OF_ROS = {"empy", "lark", "lark-parser"}
# A player of bags and a bridge read logs and links by packages of pip; nothing that flies needs them.
NOT_LIVE = {"mavlink_bridge", "player"}
NODES = sorted(
    {path.read_text().rpartition("-m ")[2].split()[0] for path in (ROOT / "programs").iterdir()}
    - {f"quadpi_ros.{name}" for name in NOT_LIVE}
)
LAUNCH_FILES = sorted(str(path) for path in (ROOT / "launch").glob("*.launch.py"))

_PACKAGES = "share/ament_index/resource_index/packages"


def foreign(modules: set[str]) -> set[str]:
    """Distributions that modules are of, beside quadpi, ROS 2 and those of the keys of package.xml."""
    package = ElementTree.parse(ROOT / "package.xml")
    keys = {item.text for tag in ("depend", "exec_depend") for item in package.iter(tag)}
    assert {key for key in keys if key.startswith("python3-")} == set(OF_KEYS)
    prefixes = os.environ.get("AMENT_PREFIX_PATH", sys.prefix).split(os.pathsep)
    ros = {path.name for prefix in prefixes for path in Path(prefix, _PACKAGES).iterdir()}
    known = {*ros, *OF_ROS, *OF_QUADPI, *(name for names in OF_KEYS.values() for name in names)}
    owners = packages_distributions()
    found = {name for module in modules - ros for name in owners.get(module, ())}
    return {name for name in found - known if not name.startswith("ros-")}


def test_there_are_nodes_and_launch_files() -> None:
    assert {"quadpi_ros.estimator_node", "quadpi_ros.live_process", "quadpi_ros.monitor_node"} <= set(NODES)
    assert len(LAUNCH_FILES) >= 3


@pytest.mark.parametrize("imported", [*NODES, *LAUNCH_FILES], ids=lambda name: Path(name).name)
def test_what_flies_imports_nothing_of_pip(imported: str) -> None:
    command = [sys.executable, imports_child.__file__, imported]
    found = subprocess.run(command, capture_output=True, text=True, check=False)
    assert found.returncode == 0, found.stderr
    modules = set(json.loads(found.stdout.splitlines()[-1]))
    assert {"numpy", "quadpi_core"} <= modules
    assert foreign(modules) == set()
    assert "scipy" not in modules, "it takes as long to import as all else"


def test_a_package_of_pip_is_found() -> None:
    assert foreign({"numpy", "rosbags", "safetensors"}) == {"rosbags", "safetensors"}
