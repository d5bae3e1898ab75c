# SPDX-FileCopyrightText: 2026 The quadpi authors
# SPDX-License-Identifier: Apache-2.0
"""What researchers import: flights, models by the protocol of scikit-learn, tables, figures.

Where somebody guesses a name that is not there, the AttributeError names the one that is.
"""

from __future__ import annotations

import re
from inspect import getattr_static
from typing import TYPE_CHECKING, Any

# By owner, what to write, and the names of other libraries and of habit that it stands for.
_GUESSES: dict[str, dict[str, str]] = {
    "quadpi_core": {
        "load_flights(logs, vehicle)": "(read|load|from)(_(bag|csv|u?log|flight|data)s?)?|Flight|Data.*",
        "WrenchModel(estimator).fit(flights)": "fit|train|(?!Load).*(Model|Regressor|Predictor|Estimator)",
        "model.predict(flights), of a WrenchModel": "predict(_.*)?|[wW]rench|forces?|moments?",
        "model.save(folder)": "save.*|dump|export",
        "evaluate(model, flights)": "score|coverage|compare|cross_val.*|metrics|validate|test",
        "model.plot(flight)": "plot.*|show",
        "Monitor(model)": "[Aa]larm|watch|load_monitor|.*Monitor|detect.*",
        "find_discrepancy(simulation, flights)": "discover.*|[dD]iscrepancy|search|missing.*",
        "load_simulation(name_or_path)": "[sS]imulat(ion|or)|Quad.*|Drone",
        "Vehicle.load(name_or_path)": ".*vehicles?|from_file",
    },
    "Flights": {
        "load_flights(logs, vehicle)": "load|read|open|from_((ros)?bag|log|csv|ulog|file|path|folder)s?",
        "Flights.from_pandas(frame, vehicle)": "from_(data_?frame|df|frame|dict)",
        "Flights.from_arrays(time_ns, vehicle=…)": "from_(numpy|array)",
        "model.plot(flight), or to_pandas() and its plots": "plot|hist|show",
        "wrench, (N, 6)": "y|targets?|forces?|moments?|torques?|thrust",
        "inputs, (N, 19), columns as quadpi_core.inputs.INPUT_NAMES": "X|features|(input|feature)_names.*",
        "flights + others": "concat|append|extend|join|merge|add",
        "flights[:3], or LeaveOneOut() of scikit-learn": "(.*_)?split|filter|select|sample|query|groupby",
        "len(flights), len(flights.time)": "n_.*|size|count",
        "names": "name|flights?|labels?",
        "to_pandas(), a table of all signals": "(?!quality).*",
    },
    "WrenchModel": {
        "fit(flights) first": "model_|left_out_",
        "load_model(folder)": "load(_.*)?|from_(?!flights).*|read|open",
        "save(folder)": "save_.*|dump|to_.*|export|write",
        "evaluate(model, flights)": "evaluate|coverage|valid.*|test|residuals?|errors?|judge|cross_.*",
        "predict_interval(flights, confidence)": ".*interval.*|predict_(quantiles?|std|proba)|conform.*",
        "predict(flights)": "transform|forecast|simulate|wrench|decision_function|apply",
        "fit(flights), which calibrates too": "train|calibrate|partial_fit|fit_.*|from_flights|identify",
        "Monitor(model)": "monitor|step|update",
        "model_, the fitted model": ".*",
    },
    "CoverageTable": {"to_pandas()": ".*"},
    "Monitor": {"step(time_ns, velocity=…, …), or replay(model, vehicle, bag, output)": ".*"},
}


def named_absence(known: str, owner: Any, name: str) -> AttributeError:
    """The error for a name that a module, class or object, called `known`, lacks; it says which to take."""
    text = f"{known} has no attribute {name!r}"
    if not name.startswith("_"):
        for instead, guesses in _GUESSES.get(known, {}).items():
            if re.fullmatch(guesses, name):
                return AttributeError(f"{text}: use {instead}", name=name, obj=owner)
    # Python itself adds a name that is spelled alike.
    return AttributeError(text, name=name, obj=owner)


class _NamesOfOthers(type):
    if not TYPE_CHECKING:  # checkers would believe that every name is there

        def __getattr__(cls, name: str) -> Any:
            raise named_absence(cls.__name__, cls, name)


class Guessable(metaclass=_NamesOfOthers):
    """What says which of its names stands for one that somebody guessed."""

    if not TYPE_CHECKING:

        def __getattr__(self, name: str) -> Any:
            if isinstance(getattr_static(type(self), name, None), property):
                # What the property lacks, not the property.
                return object.__getattribute__(self, name)
            raise named_absence(type(self).__name__, self, name)
