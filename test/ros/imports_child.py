# SPDX-FileCopyrightText: 2026 The quadpi authors
# SPDX-License-Identifier: Apache-2.0
"""`python imports_child.py NODE_MODULE|FILE.launch.py`: prints what it imports beyond a bare interpreter.

A node is configured and activated with a model, and the readers of every kind of model and of
every message of other packages are imported; a launch file gives its description.
"""

from __future__ import annotations

import sys

BEFORE = set(sys.modules)

import importlib  # noqa: E402
import importlib.util  # noqa: E402
import json  # noqa: E402
from pathlib import Path  # noqa: E402

GOLDEN_MODEL = Path(__file__).resolve().parents[1] / "golden" / "model"
PARAMETERS = {"vehicle": "bebop2", "model": f'["{GOLDEN_MODEL}"]', "autostart": "false"}
# There is no wheel of it.
if importlib.util.find_spec("tf2_msgs") is not None:
    PARAMETERS["tf_rate_hz"] = "10.0"


def configured(module: str) -> None:
    """Import the module of a node and make it ready to fly."""
    from quadpi_ros.runtime import initialise

    node = importlib.import_module(module)
    initialise()
    if module.endswith("view_node"):
        importlib.import_module("quadpi_ros.view_node").warm_up()
    elif module.endswith("marker_node"):
        node.MarkerNode()
    else:
        one = {"estimator_node": "EstimatorNode", "monitor_node": "MonitorNode"}.get(
            module.rpartition(".")[2]
        )
        for made in [getattr(node, one)()] if one else node.create_nodes():
            made.must(made.trigger_configure)
            made.must(made.trigger_activate)
    from quadpi_core.messages.adapters import known_adapters
    from quadpi_core.models.kind_registry import KINDS

    assert known_adapters()
    assert len(list(KINDS.all())) >= 4


def described(file: Path) -> None:
    """Load a launch file and take its description, as `ros2 launch --show-args` does."""
    import launch_child

    if importlib.util.find_spec("launch_ros") is None:
        sys.modules.update(launch_child.stand_ins())
    spec = importlib.util.spec_from_file_location("described", file)
    assert spec is not None
    assert spec.loader is not None
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    module.generate_launch_description()


if __name__ == "__main__":
    asked = sys.argv[1]
    sys.argv[1:] = [
        "--ros-args",
        *(part for pair in PARAMETERS.items() for part in ("-p", "{}:={}".format(*pair))),
    ]
    if asked.endswith(".launch.py"):
        described(Path(asked))
    else:
        configured(asked)
    print(json.dumps(sorted({name.partition(".")[0] for name in set(sys.modules) - BEFORE})))
