# SPDX-FileCopyrightText: 2026 The quadpi authors
# SPDX-License-Identifier: Apache-2.0
"""Three synthetic flights, a model that knows two of them, and their evaluation; a reader of pages."""

import json
import re
from dataclasses import replace
from html.parser import HTMLParser
from io import StringIO
from types import SimpleNamespace

import numpy as np
import pytest
from rich.console import Console

from quadpi_core.evaluation.evaluation_result import (
    ComparedEvaluation,
    Comparison,
    FlightResult,
    evaluate_flights,
)
from quadpi_core.flight import AXES
from quadpi_core.inputs import INPUT_INDEX, INPUT_NAMES
from quadpi_core.models.aerodynamic import AerodynamicModel, TrainingFlight
from quadpi_core.models.envelope import Envelope
from quadpi_core.models.fitted_polynomial import FittedPolynomials, PolynomialAxis
from quadpi_core.models.interval_rules import LEVELS, HeldOutRule
from quadpi_core.models.regressors import Regressor
from quadpi_core.report.evaluation_figures import LiveReplay
from quadpi_core.report.table import markdown_table

VOID = {"meta", "br", "link", "img", "input"}


class Page(HTMLParser):
    """Collects tags, text outside scripts and the content of scripts; refuses tags that do not nest."""

    def __init__(self, text):
        super().__init__()
        self.open, self.tags, self.scripts, self.text = [], [], [], ""
        self.script_attributes = []
        self.feed(text)
        assert self.open == []

    def handle_starttag(self, tag, attributes):
        self.tags.append((tag, dict(attributes)))
        if tag not in VOID:
            self.open.append(tag)
        if tag == "script":
            self.scripts.append("")
            self.script_attributes.append(dict(attributes))

    def handle_endtag(self, tag):
        assert self.open.pop() == tag

    def handle_data(self, data):
        if self.open and self.open[-1] == "script":
            self.scripts[-1] += data
        else:
            self.text += data

    def assert_needs_nothing_from_outside(self):
        for tag, attributes in self.tags:
            assert tag not in {"img", "iframe"}
            assert attributes == {"rel": "icon", "href": "data:,"} or not {"src", "href"} & set(attributes)
        addresses = {
            found for text in (*self.scripts, self.text) for found in re.findall(r"\w+://[\w.:/]*", text)
        }
        # The name space of SVG, the live page that a moment is shown by, and where uPlot comes from.
        known = {"http://www.w3.org/2000/svg", "http://127.0.0.1:8710/", "https://github.com/leeoniya/uPlot"}
        assert addresses <= known
        assert not re.search(r"url\((?!#)|@import", self.text)
        assert not any(re.search(r"^import |fetch\(", text, re.MULTILINE) for text in self.scripts)

    def figures(self, flight=None):
        """Figures of the page, or of a flight, by name; arrays as the page holds them."""
        (held,) = (
            json.loads(text)
            for text, attributes in zip(self.scripts, self.script_attributes, strict=True)
            if "data-figures" in attributes and attributes.get("data-flight") == flight
        )
        return held["figures"]

    @property
    def commands(self):
        """Commands that show a moment, by flight."""
        (place,) = (k for k, own in enumerate(self.script_attributes) if own.get("id") == "commands")
        return json.loads(self.scripts[place])


@pytest.fixture
def with_coverage():
    """with_coverage(group, axis, picp, interval) → the group with another coverage of one axis."""

    def changed(group, axis, picp, interval):
        metrics = replace(group.axes[axis], picp=picp, picp_ci=interval)
        return replace(group, axes={**group.axes, axis: metrics})

    return changed


@pytest.fixture
def rendered():
    """rendered(content, width) → what a terminal of that width shows."""

    def shown(content, width=200):
        console = Console(width=width, file=StringIO())
        console.print(content)
        return console.file.getvalue()

    return shown


@pytest.fixture
def read_page():
    """read_page(path) → Page."""
    return lambda path: Page(path.read_text(encoding="utf-8"))


def flight_result(name, speed, seed, samples=3000):
    rng = np.random.default_rng(seed)
    time = np.arange(samples) / 400
    inputs = 0.1 * rng.standard_normal((samples, len(INPUT_NAMES)))
    inputs[:, INPUT_INDEX["u"]] = speed * np.abs(np.sin(time))
    predicted = np.sin(time[:, None] + np.arange(6))
    half_width = 0.5 + 0.02 * inputs[:, [INPUT_INDEX["u"]]]
    errors = rng.normal(0, 0.25 * (1 + (speed > 10) * 2), (samples, 6))
    return FlightResult(
        name,
        AXES,
        time,
        predicted + errors,
        predicted,
        predicted - half_width,
        predicted + half_width,
        inputs,
        height=np.ones(samples),
    )


@pytest.fixture
def case():
    results = [flight_result("slow", 3, 0), flight_result("mid", 8, 1), flight_result("fast<b>", 14, 2)]
    results[:2] = training = [replace(result, in_sample=True) for result in results[:2]]
    inputs = np.vstack([result.inputs for result in training])
    labels = np.repeat([0, 1], [len(result) for result in training])
    ones = np.ones((len(inputs), 6))
    step = {"term": "mu_x * omega_avg", "coefficient": 1.5, "r2": 0.9, "fixed": False, "criterion": 0.1}
    out = {"term": "p", "coefficient": None, "r2": 0.95, "fixed": False, "criterion": 0.2}
    bias = {"term": "1", "coefficient": -0.2, "r2": None, "fixed": True}
    rule = HeldOutRule(np.ones((2, len(LEVELS))), flights_inside=1)
    polynomial = PolynomialAxis((Regressor.parse("bias"),), np.zeros(1), np.eye(1), 1.0, 0.0, rule, 1.0)
    model = AerodynamicModel(
        name="m",
        vehicle="v",
        vehicle_fingerprint="0" * 64,
        settings="default",
        cutoff_hz=15.0,
        confidence=0.95,
        fitted=FittedPolynomials(dict.fromkeys(AXES, polynomial)),
        envelope=Envelope.fit(inputs, labels, ones, ones),
        training_range=dict.fromkeys(AXES, 2.0),
        flights=tuple(TrainingFlight(result.name, "0" * 64, len(result)) for result in training),
        selection={axis: [bias, step, out] for axis in AXES},
        held_out_coverage={axis: [0.9, 0.97] for axis in AXES},
    )
    evaluation = evaluate_flights(
        results,
        {"known": ["slow", "mid"], "new & fast": ["fast<b>"]},
        model.training_range,
        0.95,
        model="m-123456789abc",
        vehicle="v",
    )
    level = np.array([0, 0, 1, 2, 2, 0], dtype=np.uint8)
    live = LiveReplay(
        flight="fast<b>",
        statistics={
            "samples_in": 6000,
            "predictions_out": 2990,
            "dropped": 0,
            "alarm_fraction": 0.25,
            "alarm_first_s": 3.25,
            "warning_first_s": 2.0,
            "latency_ms_p50": 1.0,
            "latency_ms_p99": 4.0,
        },
        time=np.arange(6.0),
        level=level,
        leverage=np.outer(level + 0.5, np.ones(6)),
        width=np.zeros((6, 6)),
        inputs_outside=[(), ("mu_x",), ("u", "mu_x"), ("u", "mu_x"), (), ()],
    )
    return SimpleNamespace(results=results, model=model, evaluation=evaluation, live=live)


@pytest.fixture
def comparison(case):
    """Two models of one method and one of another, which holds three axes only."""
    whole = vars(case.evaluation)
    forces = {
        name: replace(part, axes={axis: part.axes[axis] for axis in AXES[:3]})
        for name, part in case.evaluation.groups.items()
    }
    models = {
        "poly-paper": ComparedEvaluation(**whole, settings="paper", cutoff_hz=100.0),
        "poly": ComparedEvaluation(**whole, settings="default", cutoff_hz=30.0),
        "net": ComparedEvaluation(
            **whole | {"groups": forces, "method": "bootstrap"}, settings="default", cutoff_hz=30.0
        ),
    }
    groups = {name: part.flights for name, part in case.evaluation.groups.items()}
    return Comparison("0", "v", 0.95, False, groups, models)


@pytest.fixture
def markdown_cells():
    """markdown_cells(table) → its rows as drawn in Markdown, without the rule; all are of one length."""

    def drawn(table):
        lines = [
            [cell.strip() for cell in line.replace("\\|", "¦")[1:-1].split("|")]
            for line in markdown_table(table).splitlines()
        ]
        assert len({len(line) for line in lines}) == 1
        assert all(set(rule) <= set(":-") for rule in lines[1])
        return [lines[0], *lines[2:]]

    return drawn
