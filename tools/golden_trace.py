# SPDX-FileCopyrightText: 2026 The quadpi authors
# SPDX-License-Identifier: Apache-2.0
"""The golden trace: state, prediction and alarm of the replay of a bundled bag, as text in test/golden.

Running this renews the trace, and with `--model` its model first. The model is committed with the trace, so
that a change of the trace shows a change of estimator, inputs, prediction or alarm, not of identification.
"""

from __future__ import annotations

import argparse
import csv
import subprocess
import sys
import tempfile
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, fields
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt

from quadpi_core.errors import ModelError
from quadpi_core.flight import AXES
from quadpi_core.frames import roll_pitch_yaw_from_quaternion
from quadpi_core.logs import read_recording
from quadpi_core.logs.bag_files import Bag
from quadpi_core.logs.bag_topics import unpacked_topic
from quadpi_core.logs.bags import read_outputs
from quadpi_core.messages import sensor_messages
from quadpi_core.models.aerodynamic import AerodynamicModel
from quadpi_core.monitor.replay import replay
from quadpi_core.paths import bags_directory, whole_output

FOLDER = Path(__file__).resolve().parents[1] / "test" / "golden"
VEHICLE, METHOD, BAG = "bebop2", "polynomial", "extrapolation"
TRAINING = ("train_1", "train_2", "train_3", "train_4")
RATE_HZ = 10.0
# Processors may round differently; what differs by more, as a share of a column's range, was changed.
TOLERANCE = 1e-4
_TIME = "t_s"

Column = npt.NDArray[Any]
Table = dict[str, Column]


@dataclass(frozen=True)
class Difference:
    """One column that differs between two traces."""

    table: str
    column: str
    rows: int
    of: int
    text: str

    def __str__(self) -> str:
        """In one line: which quantity, in how many rows, where, how much."""
        return f"{self.table}: {self.column}: {self.rows} of {self.of} rows: {self.text}"


def make_trace(model: Path) -> dict[str, Table]:
    """Tables `state` and `prediction` at RATE_HZ, `alarm` with every message; t from the first IMU sample."""
    tables = replayed(AerodynamicModel.load(model), bags_directory() / f"{BAG}.mcap")
    thinned = {name: _thinned(tables[name]) for name in ("state", "prediction")}
    return {name: _as_read(table) for name, table in {**tables, **thinned}.items()}


def replayed(model: AerodynamicModel, log: Path) -> dict[str, Table]:
    """Every field of `state`, `prediction` and `alarm` of a replay, row by row, beside its time."""
    vehicle = model.load_vehicle()
    start_ns = int(read_recording(log, vehicle).imu.time_ns[0])
    with tempfile.TemporaryDirectory() as folder:
        output = Path(folder) / "replayed.mcap"
        replay(model, vehicle, log, output)
        with Bag(output) as opened:
            topic = opened.read(["/odometry"])["/odometry"]
        state = unpacked_topic(output, topic, sensor_messages.unpack_odometry)
        predictions, alarms = read_outputs(output)
    if predictions is None or alarms is None:
        raise ModelError(f"{log}: the replay gave no prediction or no alarm")
    angles = np.degrees(roll_pitch_yaw_from_quaternion(state.attitude))
    state_columns = {
        **_named("position", "north east down", state.position),
        **_named("angle_deg", "roll pitch yaw", angles),
        **_named("velocity", "u v w", state.velocity),
        **_named("rate", "p q r", state.rates),
    }
    return {
        "state": {_TIME: 1e-9 * (state.time_ns - start_ns), **state_columns},
        "prediction": {_TIME: 1e-9 * (predictions.time_ns - start_ns), **dict(_columns(predictions))},
        "alarm": {_TIME: 1e-9 * (alarms.time_ns - start_ns), **dict(_columns(alarms))},
    }


def _named(quantity: str, parts: str, values: Column) -> Table:
    return {f"{quantity}_{part}": values[:, index] for index, part in enumerate(parts.split())}


def _columns(rows: Any) -> Iterator[tuple[str, Column]]:
    """Every quantity of a dataclass of rows as columns, numbers or text, but what is not row by row."""
    count = len(rows.time_ns)
    for field in fields(rows):
        values = getattr(rows, field.name)
        if field.name == "time_ns" or len(values) != count:
            continue
        if isinstance(values, np.ndarray) and values.dtype != object:
            flat = values.reshape(count, -1)
            parts = AXES if flat.shape[1] == len(AXES) else tuple(map(str, range(flat.shape[1])))
            for index in range(flat.shape[1]):
                yield field.name if flat.shape[1] == 1 else f"{field.name}_{parts[index]}", flat[:, index]
        else:
            yield field.name, np.array(["; ".join(map(str, value)) for value in values], dtype=np.str_)


def _thinned(table: Table) -> Table:
    """The first row of each period of 1 / RATE_HZ."""
    # Times are of whole nanoseconds, whose sum may round below a whole period.
    period = np.floor(table[_TIME] * RATE_HZ + 1e-9).astype(np.int64)
    chosen = np.flatnonzero(np.r_[True, np.diff(period) > 0])
    return {name: column[chosen] for name, column in table.items()}


def _as_read(table: Table) -> Table:
    """The table as it is once written and read."""
    return {
        name: column if column.dtype.kind == "U" else np.array([float(_text(value)) for value in column])
        for name, column in table.items()
    }


def _text(value: Any) -> str:
    return value if isinstance(value, str) else f"{float(value):.6g}"


def write(trace: dict[str, Table], folder: Path) -> None:
    """Write each table as CSV."""
    for name, table in trace.items():
        with whole_output(folder / f"{name}.csv") as temporary, temporary.open("w", newline="") as file:
            writer = csv.writer(file, lineterminator="\n")
            writer.writerow(table)
            writer.writerows(map(_text, row) for row in zip(*table.values(), strict=True))


def read(folder: Path) -> dict[str, Table]:
    """Read what :func:`write` wrote."""
    trace = {}
    for path in sorted(folder.glob("*.csv")):
        with path.open(newline="") as file:
            heading, *rows = csv.reader(file)
        columns = zip(*rows, strict=True) if rows else [()] * len(heading)
        trace[path.stem] = {name: _column(column) for name, column in zip(heading, columns, strict=True)}
    return trace


def _column(texts: Sequence[str]) -> Column:
    try:
        return np.array([float(text) for text in texts])
    except ValueError:
        return np.array(texts, dtype=np.str_)


def compare(expected: dict[str, Table], found: dict[str, Table], tolerance: float = TOLERANCE) -> list[str]:
    """What differs, a line for each column, those with the most rows first; empty if nothing does.

    Rows are compared by their times; rows and columns that only one of the two has are said as well. Numbers
    may differ by the tolerance, as a share of a column's range.
    """
    lines = [
        f"{name}: only in the {_where(name, expected)}" for name in sorted(expected.keys() ^ found.keys())
    ]
    for name in sorted(expected.keys() & found.keys()):
        lines += _compare_table(name, expected[name], found[name], tolerance)
    return lines


def _where(name: str, expected: dict[str, Any]) -> str:
    return "golden trace" if name in expected else "new trace"


def _compare_table(name: str, expected: Table, found: Table, tolerance: float) -> list[str]:
    lines = [
        f"{name}: {column}: only in the {_where(column, expected)}"
        for column in sorted(expected.keys() ^ found.keys())
    ]
    times, one, other = np.intersect1d(expected[_TIME], found[_TIME], return_indices=True)
    for table, rows, where in ((expected, one, "golden"), (found, other, "new")):
        alone = np.delete(table[_TIME], rows)
        if len(alone):
            share = f"{len(alone)} of {len(table[_TIME])} rows"
            lines.append(f"{name}: {share} only in the {where} trace, from t = {alone[0]:.6g} s on")
    different = [
        difference
        for column in expected.keys() & found.keys() - {_TIME}
        if (
            difference := _compare_column(
                name, column, times, expected[column][one], found[column][other], tolerance
            )
        )
    ]
    return lines + [str(one) for one in sorted(different, key=lambda one: (-one.rows, one.column))]


def _compare_column(
    table: str, column: str, times: Column, expected: Column, found: Column, tolerance: float
) -> Difference | None:
    numbers = expected.dtype.kind == found.dtype.kind == "f"
    if not numbers:
        differs = expected.astype(np.str_) != found.astype(np.str_)
        size = differs.astype(np.float64)
    else:
        size = np.abs(found - expected)
        size[np.isnan(expected) & np.isnan(found)] = 0.0
        size[np.isnan(size)] = np.inf
        finite = expected[np.isfinite(expected)]
        differs = size > tolerance * (np.ptp(finite) if len(finite) else 1.0) + 1e-12
    if not differs.any():
        return None
    worst, first = int(np.argmax(size)), int(np.argmax(differs))
    text = f"from t = {times[first]:.6g} s on"
    if numbers:
        change = f"{expected[worst]:.6g} → {found[worst]:.6g} at t = {times[worst]:.6g} s"
        text += f", at most {size[worst]:.3g} ({change}), {np.mean(size):.3g} on average"
    else:
        text += f": {expected[first] or 'nothing'} → {found[first] or 'nothing'}"
    return Difference(table, column, int(differs.sum()), len(differs), text)


def main(arguments: Sequence[str] | None = None) -> int:
    """Renew the trace and say what changed."""
    parser = argparse.ArgumentParser(description="Renew the golden trace in test/golden.")
    parser.add_argument("--model", action="store_true", help="identify its model again first")
    options = parser.parse_args(arguments)
    model = FOLDER / "model"
    if options.model or not model.is_dir():
        bags = [str(bags_directory() / f"{name}.mcap") for name in TRAINING]
        command = [
            sys.executable,
            "-m",
            "quadpi_core.cli",
            "identify",
            *bags,
            "--vehicle",
            VEHICLE,
            "--method",
            METHOD,
            "-o",
            str(model),
        ]
        subprocess.run(command, check=True)
    trace = make_trace(model)
    changes = compare(read(FOLDER), trace)
    if changes:
        write(trace, FOLDER)
    print("\n".join(changes) or "the golden trace is as it was")
    return 0


if __name__ == "__main__":
    raise SystemExit(main())
