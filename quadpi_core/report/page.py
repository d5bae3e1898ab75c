# SPDX-FileCopyrightText: 2026 The quadpi authors
# SPDX-License-Identifier: Apache-2.0
"""Self-contained HTML pages from the templates beside this file: no network, no other file.

A figure is either fixed, or drawn for the flight that a menu selects: the page then holds one for each
flight, which is read when it is first chosen.
"""

from __future__ import annotations

import json
import shlex
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from jinja2 import Environment, PackageLoader, StrictUndefined

from quadpi_core.findings import DataQuality
from quadpi_core.flight_files import FlightLeftOut, named_files
from quadpi_core.paths import whole_output
from quadpi_core.report import ASSETS
from quadpi_core.report.figure import Figure, Space, bins_of, figures_as_json
from quadpi_core.report.style import css_colour
from quadpi_core.version import __version__

_STYLES = ("uPlot.css", "look.css", "report.css")
# Each after those that it imports from.
_SCRIPTS = ("uPlot.js", "drawing.js", "figures.js", "space.js", "report.js")


@dataclass(frozen=True)
class FlightFiles:
    """Where the flights and models of a page are, for the commands that it gives.

    Attributes:
        bags: by the name of the flight.
        models: folders.
        vehicle: name or path of the vehicle file, where the models' own is not meant.
    """

    bags: Mapping[str, Path] = field(default_factory=dict)
    models: Sequence[Path] = ()
    vehicle: str | None = None

    @classmethod
    def from_paths(
        cls, flights: Sequence[Path], models: Sequence[Path] = (), vehicle: str | None = None
    ) -> FlightFiles:
        """The files of flights, by the names that results give them."""
        return cls({file.name: file.path for file in named_files(flights)}, models, vehicle)

    def commands(self) -> dict[str, str]:
        """The command that shows each flight live, to which `--at` is added; quoted for a shell."""
        judged = [word for folder in self.models for word in ("--model", str(folder))]
        if self.vehicle is not None:
            judged += ["--vehicle", self.vehicle]
        return {name: shlex.join(["quadpi", "view", str(bag), *judged]) for name, bag in self.bags.items()}


@dataclass(frozen=True)
class Page:
    """What all pages have in common; a template adds the sections.

    Attributes:
        title: of the window.
        about: the question that the page answers.
        verdict: the answer in one sentence, as its heading.
        facts: such as vehicle and number of flights, by name.
        definitions: meaning of each term.
        figures: by name.
        flight_figures: those that follow the menu, by flight, then by kind.
        files: of the flights; empty where there are none to look at.
        remarks: on the data, above all sections: subject, such as a flight, and sentence.
    """

    title: str
    about: str
    verdict: str
    facts: Mapping[str, str]
    definitions: Mapping[str, str]
    figures: Mapping[str, Figure | Space]
    flight_figures: Mapping[str, Mapping[str, Figure | Space]] = field(default_factory=dict)
    files: FlightFiles = FlightFiles()
    remarks: Sequence[tuple[str, str]] = ()

    def write(self, path: Path, template: str, **content: Any) -> None:
        """Write the page; it appears whole or not at all.

        Args:
            path: of the HTML file.
            template: name of the file in `templates` that draws the sections.
            **content: of the sections, by the names in the template; all text is escaped.

        Raises:
            OutputError: if `path` cannot be written.
        """
        of_flights = [figure for own in self.flight_figures.values() for figure in own.values()]
        bins = bins_of([*self.figures.values(), *of_flights])
        environment = Environment(
            loader=PackageLoader("quadpi_core.report"),
            autoescape=True,
            undefined=StrictUndefined,
            trim_blocks=True,
            lstrip_blocks=True,
        )
        environment.filters["css_colour"] = css_colour
        page = environment.get_template(template).render(
            title=self.title,
            about=self.about,
            verdict=self.verdict,
            facts=self.facts,
            definitions=self.definitions,
            remarks=self.remarks,
            bins=bins,
            figures=figures_as_json(self.figures, bins),
            flight_figures={name: figures_as_json(own, bins) for name, own in self.flight_figures.items()},
            commands=_for_script(self.files.commands()),
            style="\n".join(_asset(name) for name in _STYLES),
            script=_one_module(_SCRIPTS),
            version=__version__,
            **content,
        )
        with whole_output(path) as temporary:
            temporary.write_text(page, encoding="utf-8")


def flight_remarks(
    quality: Mapping[str, DataQuality], left_out: Sequence[FlightLeftOut] = (), in_sample: Iterable[str] = ()
) -> list[tuple[str, str]]:
    """What the head of a page says of the data, each with the flight that it is about.

    Args:
        quality: remarks on the data of each flight.
        left_out: flights that were given and cannot be used.
        in_sample: flights that the model was identified on, where nothing else of the page says it.
    """
    return [
        *((flight.flight, f"left out: {flight.reason}") for flight in left_out),
        *((name, "the model was identified on this flight: in sample") for name in in_sample),
        *((name, sentence) for name, own in quality.items() for sentence in own.sentences()),
    ]


def _asset(name: str) -> str:
    return (ASSETS / name).read_text(encoding="utf-8")


def _one_module(names: Sequence[str]) -> str:
    """The text of several modules as one, which needs no imports: a page from a file cannot load any."""
    lines = (line for name in names for line in _asset(name).splitlines())
    return "\n".join(line.removeprefix("export ") for line in lines if not line.startswith("import "))


def _for_script(content: object) -> str:
    """JSON that cannot end the script element that holds it."""
    return json.dumps(content).replace("<", "\\u003c")
