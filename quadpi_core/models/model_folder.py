# SPDX-FileCopyrightText: 2026 The quadpi authors
# SPDX-License-Identifier: Apache-2.0
"""Models on disk: a folder with model.json (what and from where) and arrays.safetensors (numbers).

model.json holds the hash of the arrays, and the model's identity is the hash of model.json, so any
change of either shows. Both are data: reading them executes nothing.
"""

from __future__ import annotations

import hashlib
import json
import platform
import time
from dataclasses import asdict, dataclass, replace
from pathlib import Path
from typing import Annotated, Any

import numpy as np
from pydantic import Field
from safetensors.numpy import load as load_arrays
from safetensors.numpy import save as save_arrays

from quadpi_core.bounded_files import JSON_BYTES_MAX, parse_json, read_bounded
from quadpi_core.config_schema import Flag, OneOf, Real, Text, parse_config
from quadpi_core.errors import ModelError, OutputError
from quadpi_core.flight import AXES
from quadpi_core.frames import Array
from quadpi_core.models.aerodynamic import METHODS, AerodynamicModel, TrainingFlight
from quadpi_core.models.alarm_limits import AlarmLimits
from quadpi_core.models.envelope import Envelope
from quadpi_core.models.model_kind import FittedAxis
from quadpi_core.paths import require_folder, whole_output
from quadpi_core.scratch import is_being_replaced
from quadpi_core.version import __version__

MODEL_FILE = "model.json"
ARRAYS_FILE = "arrays.safetensors"
FORMAT = 5


def save_model(model: AerodynamicModel, folder: Path) -> AerodynamicModel:
    """Write `model` to `folder`, whole or not at all; returns it with name and identity.

    Raises:
        OutputError: if the folder cannot be written, or holds what is not part of a model and would be lost.
    """
    require_replaceable(folder)
    arrays: dict[str, Array] = {}
    axes: dict[str, Any] = {}
    for axis, fitted in model.fitted.items():
        arrays |= {f"{axis}.{name}": values for name, values in fitted.arrays().items()}
        axes[axis] = fitted.to_json() | {
            "training_range": model.training_range[axis],
            "selection": model.selection[axis],
            "held_out_coverage": model.held_out_coverage[axis],
        }
    array_bytes = save_arrays(arrays)
    content = {
        "format": FORMAT,
        "method": model.method,
        "settings": model.settings,
        "vehicle": model.vehicle,
        "vehicle_fingerprint": model.vehicle_fingerprint,
        "cutoff_hz": model.cutoff_hz,
        "confidence": model.confidence,
        "axes": axes,
        "envelope": model.envelope.to_json(),
        "alarm": model.alarm_limits.to_json(),
        "flights": [asdict(flight) for flight in model.flights],
        "versions": {"quadpi": __version__, "numpy": np.__version__, "python": platform.python_version()},
        "arrays_sha256": hashlib.sha256(array_bytes).hexdigest(),
    }
    text = json.dumps(content, indent=1, allow_nan=False) + "\n"
    with whole_output(folder) as temporary:
        temporary.mkdir()
        (temporary / ARRAYS_FILE).write_bytes(array_bytes)
        (temporary / MODEL_FILE).write_text(text)
    return replace(model, name=folder.name, identity=_identity(folder.name, text))


def load_model(folder: Path) -> AerodynamicModel:
    """Read a model folder.

    Raises:
        ModelError: naming the file that is missing, altered, not understood or no part of a model.
    """
    path = folder / MODEL_FILE
    text, array_bytes = _read_files(folder)
    try:
        content = parse_json(text)
        _require_known_format(content)
        described = parse_config(_ModelFile, content, f"{MODEL_FILE}: not a quadpi model", ModelError)
        if hashlib.sha256(array_bytes).hexdigest() != described.arrays_sha256:
            raise ModelError(f"{ARRAYS_FILE}: its hash is not the one in {MODEL_FILE}: the file was altered")
        model = _model(described, content["axes"], load_arrays(array_bytes))
        model = replace(model, name=folder.name, identity=_identity(folder.name, text))
        # A confidence that has no intervals is the fault of the file, not of whoever asks for them.
        for fitted in model.fitted.values():
            fitted.rule.factor(model.confidence)
        return model
    except ModelError as error:
        raise ModelError(f"{folder}: {error}") from error
    except Exception as error:  # parts of a model raise many kinds of errors on damaged input
        raise ModelError(f"{path}: not a quadpi model: {type(error).__name__} {error}") from error


# model.json is written by quadpi alone: what its types do not declare is passed over, not refused.


@dataclass(frozen=True, kw_only=True)
class _Step:
    """A step of the selection of regressors, as `StepwisePolynomial.selection_log` gives it."""

    term: Text
    fixed: Flag
    coefficient: Real | None
    r2: Real | None
    removed: tuple[Text, ...] = ()
    sse: Real | None = None
    criterion: Real | None = None


@dataclass(frozen=True, kw_only=True)
class _AxisFile:
    """What an axis has beside its method's own keys."""

    training_range: Real
    selection: tuple[_Step, ...]
    held_out_coverage: list[Real]


@dataclass(frozen=True, kw_only=True)
class _ModelFile:
    """The content of model.json; the classes named `stored` and `from_json` read the keys typed as dict."""

    method: Text
    settings: str
    vehicle: str
    vehicle_fingerprint: str
    cutoff_hz: Real
    confidence: Real
    axes: Annotated[dict[Annotated[str, OneOf(*AXES)], _AxisFile], Field(min_length=1)]
    envelope: dict[str, Any]
    alarm: dict[str, Any]
    flights: tuple[TrainingFlight, ...]
    arrays_sha256: str


def _require_known_format(content: Any) -> None:
    if not isinstance(content, dict) or "format" not in content:
        raise ModelError(f"{MODEL_FILE}: not a quadpi model: missing key `format`")
    if content["format"] != FORMAT:
        raise ModelError(
            f"{MODEL_FILE}: format {content['format']!r} is not known to this version ({FORMAT})"
        )
    if content.get("method") not in METHODS:
        raise ModelError(
            f"{MODEL_FILE}: method {content.get('method')!r} is not known to this version "
            f"({', '.join(METHODS)})"
        )


def _model(described: _ModelFile, entries: dict[str, Any], arrays: dict[str, Array]) -> AerodynamicModel:
    """The model without its name and identity; `entries` are the axes with the keys of their method."""
    axes = described.axes
    return AerodynamicModel(
        name="",
        vehicle=described.vehicle,
        vehicle_fingerprint=described.vehicle_fingerprint,
        settings=described.settings,
        cutoff_hz=described.cutoff_hz,
        confidence=described.confidence,
        fitted={axis: _axis(described.method, axis, entries[axis], arrays) for axis in axes},
        envelope=Envelope.from_json(described.envelope),
        training_range={axis: entry.training_range for axis, entry in axes.items()},
        flights=described.flights,
        selection={axis: entries[axis]["selection"] for axis in axes},
        held_out_coverage={axis: entry.held_out_coverage for axis, entry in axes.items()},
        alarm_limits=AlarmLimits.from_json(described.alarm),
    )


def _axis(method: str, axis: str, entry: dict[str, Any], arrays: dict[str, Array]) -> FittedAxis:
    prefix = f"{axis}."
    own = {name.removeprefix(prefix): values for name, values in arrays.items() if name.startswith(prefix)}
    if not all(np.all(np.isfinite(values)) for values in own.values()):
        raise ModelError(f"{ARRAYS_FILE}: {axis}: numbers that are not finite")
    try:
        return METHODS[method].stored(entry, own)
    except ModelError as error:
        raise ModelError(f"{axis}: {error}") from error


def require_replaceable(folder: Path) -> None:
    """Refuse a folder that a model cannot take the place of.

    Raises:
        OutputError: if it cannot be replaced, or holds what is not part of a model and would be lost.
    """
    require_folder(folder.parent)
    if foreign := _foreign(folder):
        raise OutputError(f"{folder}: holds {foreign}, which is not part of a model: not replaced")


def _foreign(folder: Path) -> str | None:
    """Name of something in a folder that is not part of a model."""
    try:
        names = sorted({path.name for path in folder.iterdir()} - {MODEL_FILE, ARRAYS_FILE})
    except OSError:
        return None
    return names[0] if names else None


def _read_files(folder: Path) -> tuple[str, bytes]:
    """Both files of one model, also where a writer replaces the folder meanwhile."""
    for _ in range(_READS_MAX):
        before = _number(folder)
        try:
            # First, so that a folder without a model is refused as such, not for its other files.
            text = _read(folder / MODEL_FILE).decode(errors="replace")
            if foreign := _foreign(folder):
                raise ModelError(f"{folder}: holds {foreign}, which is not part of a model: take it out")
            array_bytes = _read(folder / ARRAYS_FILE)
        except ModelError:
            if _number(folder) == before and before is not None:
                raise
            missing = before is None
        else:
            if _number(folder) == before:
                return text, array_bytes
            missing = False
        if missing and not is_being_replaced(folder):
            _read(folder / MODEL_FILE)
        time.sleep(_READ_AGAIN_S)
    raise ModelError(f"{folder}: replaced while it was read, {_READS_MAX} times")


# A writer replaces a folder in far less; several may do so one after the other.
_READS_MAX, _READ_AGAIN_S = 50, 0.01


def _number(folder: Path) -> tuple[int, int] | None:
    """Identity of a folder, which differs from that of another of the same name; None if there is none."""
    try:
        found = folder.stat()
    except OSError:
        return None
    return found.st_ino, found.st_mtime_ns


def _read(path: Path) -> bytes:
    try:
        return read_bounded(path, JSON_BYTES_MAX)
    except OSError as error:
        raise ModelError(f"{path}: cannot be read: {error.strerror}") from error
    except ValueError as error:
        raise ModelError(f"{path}: {error}") from error


def _identity(name: str, text: str) -> str:
    return f"{name}@{hashlib.sha256(text.encode()).hexdigest()[:12]}"
