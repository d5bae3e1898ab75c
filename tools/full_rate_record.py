# SPDX-FileCopyrightText: 2026 The quadpi authors
# SPDX-License-Identifier: Apache-2.0
"""A record of every field of replays at full rate, before and after work that must not change them.

`record FOLDER` identifies a model by each method for each vehicle, unless the folder has them, and replays
flights by it. `compare OLD NEW` says what differs by more than rounding. To compare two versions of the code,
copy `models` of the old folder into the new one before it is recorded.
"""

from __future__ import annotations

import argparse
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import golden_trace
import numpy as np
from golden_trace import Table

from quadpi_core.identification.identify import identify
from quadpi_core.identification.prepared_flights import prepare_flights
from quadpi_core.models.aerodynamic import AerodynamicModel
from quadpi_core.models.model_kind import IdentifyOptions
from quadpi_core.models.regressors import load_pools
from quadpi_core.parallel import Workers
from quadpi_core.paths import bags_directory, data_directory, whole_output
from quadpi_core.vehicle import Vehicle

METHODS = ("bootstrap", "physical", "polynomial", "quality-driven")
# What differs by more, as a share of a column's range, was changed.
TOLERANCE = 1e-9


@dataclass(frozen=True)
class Recorded:
    """Flights of one vehicle: some that models are identified on, and some that are replayed."""

    vehicle: str
    folder: Path
    identified: tuple[str, ...]
    replayed: tuple[str, ...]


def recorded() -> list[Recorded]:
    """Bundled flights, and real ones where QUADPI_DATA has them."""
    bundled = Recorded(
        "bebop2",
        bags_directory(),
        tuple(f"train_{k}.mcap" for k in range(1, 5)),
        ("interpolation.mcap", "extrapolation.mcap", "faults.mcap"),
    )
    data = data_directory()
    real = [
        Recorded(
            "crazyflie_rpm",
            data / "imrc_brushless",
            ("eckart00", "eckart02", "eckart04", "eckart07"),
            ("eckart06",),
        ),
        Recorded(
            "indiflight",
            data / "indiflight",
            ("LOG00257.BFL", "LOG00258.BFL", "LOG00259.BFL", "LOG00262.BFL"),
            ("LOG00340.BFL",),
        ),
        Recorded(
            "neurobem",
            data / "neurobem",
            ("bemnn20210218170320seg2.mat", "bemnn20210218171908seg2.mat"),
            ("bemnn20210223104803seg2.mat",),
        ),
    ]
    return [bundled, *(own for own in real if own.folder.is_dir())]


def models(own: Recorded, folder: Path) -> dict[str, Path]:
    """The folder of the model of each method, identified where it is not there."""
    folders = {method: folder / "models" / f"{own.vehicle}-{method}" for method in METHODS}
    missing = [method for method, path in folders.items() if not path.is_dir()]
    if missing:
        vehicle, paths = Vehicle.load(own.vehicle), [own.folder / name for name in own.identified]
        flights = prepare_flights(paths, vehicle, workers=Workers(1))
        for method in missing:
            found = identify(flights, vehicle, load_pools("quadrotor"), IdentifyOptions(method=method))
            found.save(folders[method])
    return folders


def record(folder: Path) -> list[str]:
    """Replay every flight by every method into the folder; names of the files."""
    written = []
    for own in recorded():
        for method, path in models(own, folder).items():
            model = AerodynamicModel.load(path)
            for name in own.replayed:
                tables = golden_trace.replayed(model, own.folder / name)
                written.append(f"{own.vehicle}-{Path(name).stem}-{method}.npz")
                columns: dict[str, Any] = {
                    f"{table}/{column}": values
                    for table, found in tables.items()
                    for column, values in found.items()
                }
                with whole_output(folder / written[-1]) as temporary, temporary.open("wb") as file:
                    np.savez_compressed(file, **columns)
    return written


def read(path: Path) -> dict[str, Table]:
    """The tables of one file."""
    tables: dict[str, Table] = {}
    with np.load(path) as arrays:
        for key in arrays.files:
            table, _, column = key.partition("/")
            tables.setdefault(table, {})[column] = arrays[key]
    return tables


def compare(old: Path, new: Path) -> list[str]:
    """What differs between two records, a line for each column; and files that only one of them has."""
    names = [{path.name for path in folder.glob("*.npz")} for folder in (old, new)]
    empty = [str(folder) for folder, own in zip((old, new), names, strict=True) if not own]
    if empty:
        raise SystemExit(f"{empty[0]}: holds no record")
    lines = [f"{name}: only in one of the two" for name in sorted(names[0] ^ names[1])]
    for name in sorted(names[0] & names[1]):
        found = golden_trace.compare(read(old / name), read(new / name), TOLERANCE)
        lines += [f"{name}: {line}" for line in found]
    return lines


def main(arguments: Sequence[str] | None = None) -> int:
    """Record or compare; 1 where anything differs."""
    parser = argparse.ArgumentParser(description="Record replays at full rate, and compare two records.")
    commands = parser.add_subparsers(dest="command", required=True)
    commands.add_parser("record").add_argument("folder", type=Path)
    comparing = commands.add_parser("compare")
    comparing.add_argument("old", type=Path)
    comparing.add_argument("new", type=Path)
    options = parser.parse_args(arguments)
    if options.command == "record":
        options.folder.mkdir(parents=True, exist_ok=True)
        print(f"{len(record(options.folder))} replays recorded")
        return 0
    changes = compare(options.old, options.new)
    print("\n".join(changes) or "nothing differs")
    return int(bool(changes))


if __name__ == "__main__":
    raise SystemExit(main())
