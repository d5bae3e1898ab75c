# SPDX-FileCopyrightText: 2026 The quadpi authors
# SPDX-License-Identifier: Apache-2.0
"""Self-contained HTML pages from the templates beside this file: no network, no other file.

Every page has a menu of flights. A figure is either fixed, or drawn for the flight that the menu selects: the
page then holds one for each flight, by the name "KIND FLIGHT".
"""

from __future__ import annotations

import json
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import plotly.graph_objects as go
from jinja2 import Environment, PackageLoader, StrictUndefined
from plotly.offline import get_plotlyjs

from quadpi_core.paths import whole_output
from quadpi_core.report.table import html_body, html_head
from quadpi_core.version import __version__


@dataclass(frozen=True)
class Page:
    """What all pages have in common; a template adds the sections.

    Attributes:
        title: of the window.
        about: the question that the page answers, as its heading.
        verdict: the answer in one sentence.
        facts: such as vehicle and number of flights, by name.
        definitions: meaning of each term.
        figures: by name, or "KIND FLIGHT" for those that follow the menu.
    """

    title: str
    about: str
    verdict: str
    facts: Mapping[str, str]
    definitions: Mapping[str, str]
    figures: Mapping[str, go.Figure]

    def write(self, path: Path, template: str, **content: Any) -> None:
        """Write the page; it appears whole or not at all.

        Args:
            path: of the HTML file.
            template: name of the file in `templates` that draws the sections.
            **content: of the sections, by the names in the template; all text is escaped.

        Raises:
            OutputError: if `path` cannot be written.
        """
        environment = Environment(
            loader=PackageLoader("quadpi_core.report"),
            autoescape=True,
            undefined=StrictUndefined,
            trim_blocks=True,
            lstrip_blocks=True,
        )
        environment.filters.update(html_head=html_head, html_body=html_body)
        page = environment.get_template(template).render(
            **vars(self) | {"figures": _json_for_script(self.figures)},
            plotly=get_plotlyjs(),
            version=__version__,
            **content,
        )
        with whole_output(path) as temporary:
            temporary.write_text(page, encoding="utf-8")


def _json_for_script(figures: Mapping[str, go.Figure]) -> str:
    """Figures as JSON that cannot end the script element that holds it."""
    entries = (f"{json.dumps(name)}:{figure.to_json()}" for name, figure in figures.items())
    return "{" + ",".join(entries).replace("<", "\\u003c") + "}"
