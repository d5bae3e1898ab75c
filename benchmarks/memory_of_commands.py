# SPDX-FileCopyrightText: 2026 The quadpi authors
# SPDX-License-Identifier: Apache-2.0
"""Peak memory of `quadpi replay`, `import` and `info` on two hours of flight at 500 Hz.

Extrapolated linearly from two shorter flights. The peak is of the whole process; most of it are libraries.
"""

from __future__ import annotations

import subprocess
import sys
import tempfile
from pathlib import Path

from benchmarks import Result
from benchmarks.swings import IMU_HZ, METHODS, VEHICLE, three_models, write_long_bag
from quadpi_core.vehicle import Vehicle

BAG = "long.mcap"
# Arguments of each command, given the folder with the bag and a model.
_COMMANDS = {
    "replay_memory_mib": lambda folder: [
        *("replay", str(folder / METHODS[0]), str(folder / BAG)),
        *("-o", str(folder / "replayed.mcap")),
    ],
    "import_memory_mib": lambda folder: [
        *("import", str(folder / BAG), "--vehicle", VEHICLE),
        *("-o", str(folder / "imported")),
    ],
    "info_memory_mib": lambda folder: ["info", str(folder / BAG)],
}
NAMES = tuple(_COMMANDS)

MEASURED_MIN = (20, 40)
FLIGHT_MIN = 120
GOAL_MIB = 600.0
# Of the process alone: what the system reports of a child may be what its parent took.
_CHILD = """
import pathlib, re
from quadpi_core.cli import main
try:
    main()
finally:
    status = pathlib.Path("/proc/self/status").read_text()
    pathlib.Path({peak!r}).write_text(re.search(r"VmHWM:\\s*(\\d+)", status)[1])
"""


def run() -> list[Result]:
    vehicle = Vehicle.load(VEHICLE)
    peaks: dict[str, list[float]] = {name: [] for name in NAMES}
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        three_models(folder, vehicle)
        # The first run writes caches of Python, which takes more memory.
        for minutes in (1, *MEASURED_MIN):
            write_long_bag(folder / BAG, vehicle, 60.0 * minutes)
            for command, arguments in _COMMANDS.items():
                peaks[command].append(_peak_mib(folder, arguments(folder)))
    return [_result(command, *measured[1:]) for command, measured in peaks.items()]


def _result(name: str, brief: float, long: float) -> Result:
    shorter, longer = MEASURED_MIN
    growth = (long - brief) / (longer - shorter)
    return Result(
        name,
        long + growth * (FLIGHT_MIN - longer),
        "MiB",
        f"{brief:.0f} MiB for {shorter} minutes at {IMU_HZ:.0f} Hz, {long:.0f} for {longer}, "
        f"extrapolated to {FLIGHT_MIN}",
        goal=GOAL_MIB,
        at_most=True,
    )


def _peak_mib(folder: Path, arguments: list[str]) -> float:
    """Peak memory of a command."""
    peak = folder / "peak"
    child = [sys.executable, "-c", _CHILD.format(peak=str(peak)), *arguments]
    subprocess.run(child, check=True, stdout=subprocess.DEVNULL)
    return int(peak.read_text()) / 1024
