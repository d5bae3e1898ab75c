# SPDX-FileCopyrightText: 2026 The quadpi authors
# SPDX-License-Identifier: Apache-2.0
"""Cache of identified models, from which an interrupted run continues."""

from __future__ import annotations

import hashlib
from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass
from pathlib import Path

from quadpi_core.errors import ModelError
from quadpi_core.identification.identify import identify
from quadpi_core.identification.prepared_flights import PreparedFlight
from quadpi_core.models.aerodynamic import AerodynamicModel
from quadpi_core.models.kind_registry import kind_of
from quadpi_core.models.model_kind import IdentifyOptions
from quadpi_core.models.regressors import CandidatePool
from quadpi_core.paths import JSON_BYTES_MAX, parse_json, read_bounded, write_json
from quadpi_core.validation.validation_case import code_fingerprint
from quadpi_core.vehicle import Vehicle
from quadpi_core.version import __version__


@dataclass(frozen=True)
class ModelCache:
    """Models of one vehicle, identified once and loaded by later runs.

    Attributes:
        vehicle, pools: see :func:`quadpi_core.identification.identify.identify`.
        folder: of the model folders.
    """

    vehicle: Vehicle
    pools: Mapping[str, CandidatePool]
    folder: Path

    def model(
        self, name: str, flights: Sequence[PreparedFlight], options: IdentifyOptions
    ) -> AerodynamicModel:
        """The stored model if flights, options and code are unchanged; else a new one, which is stored.

        A file beside the model's folder records its origin.

        Raises:
            ModelError: if the model cannot be identified, naming the axis.
            OutputError: if it cannot be stored.
        """
        kind = kind_of(options)
        pools = {axis: vars(pool) for axis, pool in self.pools.items()}
        origin: dict[str, object] = {
            "quadpi": __version__,
            "code": code_fingerprint(),
            **asdict(options),
            "method": [kind.name, asdict(kind)],
            "vehicle": self.vehicle.fingerprint,
            "candidates": hashlib.sha256(repr(pools).encode()).hexdigest(),
            "flights": {flight.name: flight.sha256 for flight in flights},
        }
        folder = self.folder / name
        stored = _load(folder, origin)
        if stored is not None:
            return stored
        return _store(identify(flights, self.vehicle, self.pools, options), folder, origin)


def _store(model: AerodynamicModel, folder: Path, origin: dict[str, object]) -> AerodynamicModel:
    model = model.save(folder)
    write_json(_origin_file(folder), origin | {"model": model.identity})
    return model


def _load(folder: Path, origin: dict[str, object]) -> AerodynamicModel | None:
    try:
        model = AerodynamicModel.load(folder)
        kept = parse_json(read_bounded(_origin_file(folder), JSON_BYTES_MAX))
    except (ModelError, OSError, ValueError):
        return None
    return model if kept == origin | {"model": model.identity} else None


def _origin_file(folder: Path) -> Path:
    return folder.with_name(f"{folder.name}.origin.json")
