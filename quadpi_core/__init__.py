# SPDX-FileCopyrightText: 2026 The quadpi authors
# SPDX-License-Identifier: Apache-2.0
"""Aerodynamic models of quadrotors with prediction intervals, and the monitor that watches them.

    import quadpi_core as qp

    flights = qp.load_flights("bags/train_*.mcap", vehicle="bebop2")
    model = qp.WrenchModel(estimator="physical").fit(flights)

The names here are those that most programs need; docs/library.md shows them with their units. Each is
imported from its room when it is first used, so that `import quadpi_core` costs next to nothing.
"""

from __future__ import annotations

import warnings
from importlib import import_module
from typing import TYPE_CHECKING, Any

from quadpi_core.version import __version__ as __version__

if TYPE_CHECKING:
    from quadpi_core.discrepancy.loading import load_simulation as load_simulation
    from quadpi_core.discrepancy.study import read_flights as read_flights
    from quadpi_core.discrepancy.study import study as study
    from quadpi_core.errors import QuadpiError as QuadpiError
    from quadpi_core.evaluation.evaluate import judge as judge
    from quadpi_core.identification.identify import identify as identify
    from quadpi_core.identification.prepared_flights import prepare_flights as prepare_flights
    from quadpi_core.library.coverage_table import evaluate as evaluate
    from quadpi_core.library.flights import Flights as Flights
    from quadpi_core.library.flights import load_flights as load_flights
    from quadpi_core.library.found_discrepancy import find_discrepancy as find_discrepancy
    from quadpi_core.library.live_monitor import Monitor as Monitor
    from quadpi_core.library.wrench_model import WrenchModel as WrenchModel
    from quadpi_core.library.wrench_model import load_model as load_model
    from quadpi_core.logs import read_recording as read_recording
    from quadpi_core.models.aerodynamic import AerodynamicModel as AerodynamicModel
    from quadpi_core.models.model_kind import IdentifyOptions as IdentifyOptions
    from quadpi_core.models.regressors import load_pools as load_pools
    from quadpi_core.monitor.alarm import MonitorSettings as MonitorSettings
    from quadpi_core.monitor.replay import replay as replay
    from quadpi_core.simulation.scenario import load_scenario as load_scenario
    from quadpi_core.simulation.simulated_bags import simulate as simulate
    from quadpi_core.vehicle import Vehicle as Vehicle

_ROOMS = {
    "AerodynamicModel": "models.aerodynamic",
    "Flights": "library.flights",
    "IdentifyOptions": "models.model_kind",
    "Monitor": "library.live_monitor",
    "MonitorSettings": "monitor.alarm",
    "QuadpiError": "errors",
    "Vehicle": "vehicle",
    "WrenchModel": "library.wrench_model",
    "evaluate": "library.coverage_table",
    "find_discrepancy": "library.found_discrepancy",
    "identify": "identification.identify",
    "judge": "evaluation.evaluate",
    "load_flights": "library.flights",
    "load_model": "library.wrench_model",
    "load_pools": "models.regressors",
    "load_scenario": "simulation.scenario",
    "load_simulation": "discrepancy.loading",
    "prepare_flights": "identification.prepared_flights",
    "read_flights": "discrepancy.study",
    "read_recording": "logs",
    "replay": "monitor.replay",
    "simulate": "simulation.simulated_bags",
    "study": "discrepancy.study",
}
# Names that others replace here; their functions stay what the rooms call.
_REPLACED = {
    "identify": "WrenchModel(estimator).fit(flights)",
    "judge": "evaluate(model, flights)",
    "prepare_flights": "load_flights(logs, vehicle)",
    "read_flights": "load_flights(logs, vehicle)",
    "study": "find_discrepancy(simulation, flights)",
}

__all__ = sorted(_ROOMS.keys() - _REPLACED)  # noqa: PLE0605 - imported when used


def __getattr__(name: str) -> Any:
    """Import a public name from its room."""
    if name not in _ROOMS:
        raise import_module(f"{__name__}.library").named_absence(__name__, import_module(__name__), name)
    if name in _REPLACED:
        warnings.warn(f"{__name__}.{name}: use {_REPLACED[name]}", DeprecationWarning, stacklevel=2)
    return getattr(import_module(f"{__name__}.{_ROOMS[name]}"), name)


def __dir__() -> list[str]:
    """The public names, beside those that every module has."""
    return sorted({*(name for name in globals() if name.startswith("__")), *_ROOMS})
