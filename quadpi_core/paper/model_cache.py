# SPDX-FileCopyrightText: 2026 The quadpi authors
# SPDX-License-Identifier: Apache-2.0
"""Models that a long computation keeps, so that a later run goes on where one ended."""

from __future__ import annotations

import functools
import hashlib
from collections.abc import Callable, Sequence
from pathlib import Path

from quadpi_core import __version__
from quadpi_core.bounded_files import JSON_BYTES_MAX, parse_json, read_bounded
from quadpi_core.errors import ModelError
from quadpi_core.identification.identify import MethodName, Settings, identify
from quadpi_core.identification.prepared_flights import PreparedFlight
from quadpi_core.models.aerodynamic import AerodynamicModel
from quadpi_core.models.candidate_pool import CandidatePool
from quadpi_core.paths import write_json
from quadpi_core.vehicle import Vehicle

_PACKAGE = Path(__file__).resolve().parents[1]
# Folders of the package that no model depends on.
_PRESENTATION = ("report", "cli")


def identify_or_take(
    flights: Sequence[PreparedFlight],
    vehicle: Vehicle,
    pools: dict[str, CandidatePool],
    folder: Path | None,
    *,
    method: MethodName,
    settings: Settings,
    cutoff_hz: float,
    confidence: float,
    seed: int = 0,
    device: str = "cpu",
    progress: Callable[[str], None] = lambda _: None,
) -> AerodynamicModel:
    """The model in a folder if it was identified from the same, by the same code; else a new one, kept there.

    The folder has a file beside it that says what its model was identified from; None keeps nothing. All
    other arguments are those of :func:`quadpi_core.identification.identify.identify`.

    Raises:
        ModelError: if the model cannot be identified, naming the axis.
        OutputError: if it cannot be kept.
    """
    origin: dict[str, object] = {
        "quadpi": __version__,
        "code": code_fingerprint(),
        "method": method,
        "settings": settings,
        "cutoff_hz": cutoff_hz,
        "confidence": confidence,
        "seed": seed,
        "device": device,
        "vehicle": vehicle.fingerprint,
        "candidates": hashlib.sha256(repr(pools).encode()).hexdigest(),
        "flights": {flight.name: flight.sha256 for flight in flights},
    }
    if folder is not None and (kept := _kept(folder, origin)) is not None:
        return kept
    model = identify(
        flights,
        vehicle,
        pools,
        method=method,
        cutoff_hz=cutoff_hz,
        settings=settings,
        confidence=confidence,
        seed=seed,
        device=device,
        progress=progress,
    )
    return model if folder is None else _keep(model, folder, origin)


def named(progress: Callable[[str], None], name: str) -> Callable[[str], None]:
    """Progress that says of which model it is."""
    return lambda text: progress(f"{name}: {text}")


@functools.cache
def code_fingerprint(package: Path = _PACKAGE) -> str:
    """Hash of the code that identifies models: a version in development changes without a new number."""
    digest = hashlib.sha256()
    for path in sorted(package.rglob("*.py")):
        place = path.relative_to(package)
        if place.parts[0] not in _PRESENTATION:
            digest.update(place.as_posix().encode() + b"\0" + path.read_bytes())
    return digest.hexdigest()[:16]


def _keep(model: AerodynamicModel, folder: Path, origin: dict[str, object]) -> AerodynamicModel:
    model = model.save(folder)
    write_json(_origin_file(folder), origin | {"model": model.identity})
    return model


def _kept(folder: Path, origin: dict[str, object]) -> AerodynamicModel | None:
    try:
        model = AerodynamicModel.load(folder)
        kept = parse_json(read_bounded(_origin_file(folder), JSON_BYTES_MAX))
    except (ModelError, OSError, ValueError):
        return None
    return model if kept == origin | {"model": model.identity} else None


def _origin_file(folder: Path) -> Path:
    return folder.with_name(f"{folder.name}.origin.json")
