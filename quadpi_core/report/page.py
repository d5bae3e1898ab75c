# SPDX-FileCopyrightText: 2026 The quadpi authors
# SPDX-License-Identifier: Apache-2.0
"""A self-contained page, no network, no other file; and the pieces of HTML that all pages are made of.

A page holds one menu of flights. Its figures either have a name and are always there, or are of a kind,
and show the flight that the menu says: `figures` then holds "KIND FLIGHT" for each flight of the menu.
"""

from __future__ import annotations

import json
from collections.abc import Iterable, Mapping, Sequence
from html import escape
from importlib import resources
from pathlib import Path
from string import Template

import plotly.graph_objects as go
from plotly.offline import get_plotlyjs

from quadpi_core import __version__
from quadpi_core.paths import whole_output


def write_page(path: Path, title: str, parts: Iterable[str], figures: Mapping[str, go.Figure]) -> None:
    """Write the page; it appears whole or not at all.

    Args:
        path: of the HTML file.
        title: for the window, not escaped.
        parts: of the body as HTML, from top to bottom.
        figures: by name, and "KIND FLIGHT" for figures that follow the menu.

    Raises:
        OutputError: if `path` cannot be written.
    """
    template = Template(resources.files("quadpi_core.report").joinpath("page.html").read_text("utf-8"))
    page = template.substitute(
        title=escape(title),
        plotly=get_plotlyjs(),
        body="\n".join(parts),
        figures=_json_for_script(figures),
    )
    with whole_output(path) as temporary:
        temporary.write_text(page, encoding="utf-8")


def _json_for_script(figures: Mapping[str, go.Figure]) -> str:
    """Figures as JSON that cannot end the script element that holds it."""
    entries = (f"{json.dumps(name)}:{figure.to_json()}" for name, figure in figures.items())
    return "{" + ",".join(entries).replace("<", "\\u003c") + "}"


def heading(about: str, verdict: str, facts: Mapping[str, str]) -> str:
    """What the page is about, what it says in one sentence, and what of; verdict and facts are escaped."""
    entries = "".join(f"<div><dt>{key}</dt><dd>{escape(value)}</dd></div>" for key, value in facts.items())
    return (
        f"<header><h1>quadpi · {about}</h1>"
        f'<p class="verdict">{escape(verdict)}</p><dl class="facts">{entries}</dl></header>'
    )


def section(title: str, caption: str, content: str) -> str:
    """A box with a title and a line that says how to read it."""
    return f'<section><h2>{title}</h2><p class="caption">{caption}</p>{content}</section>'


def figure(name: str) -> str:
    """The place of a figure."""
    return f'<div class="figure" data-figure="{escape(name)}"></div>'


def figure_of_flight(kind: str) -> str:
    """The place of a figure of the flight that the menu says."""
    return f'<div class="figure" data-kind="{kind}"></div>'


def flight_menu(groups: Mapping[str, Sequence[str]]) -> str:
    """The menu of flights, by group; a group without a name has no heading of its own."""
    entries = []
    for group, flights in groups.items():
        options = "".join(f'<option value="{escape(name)}">{escape(name)}</option>' for name in flights)
        entries.append(f'<optgroup label="{escape(group)}">{options}</optgroup>' if group else options)
    return f'<label>Flight <select id="flight">{"".join(entries)}</select></label>'


def table(head: str, rows: Iterable[str]) -> str:
    """A table that scrolls sideways where the window is narrow; rows as HTML cells."""
    body = "".join(f"<tr>{row}</tr>" for row in rows)
    return f'<div class="scroll"><table><thead>{head}</thead><tbody>{body}</tbody></table></div>'


def cells(tag: str, texts: Iterable[str]) -> str:
    """Cells `td` or `th` of texts that are HTML already."""
    return "".join(f"<{tag}>{text}</{tag}>" for text in texts)


def footer(definitions: Mapping[str, str]) -> str:
    """What the words of the page mean, and the version that wrote it."""
    text = "".join(f"<dt>{key}</dt><dd>{value}</dd>" for key, value in definitions.items())
    return f"<footer><dl>{text}</dl><p>quadpi {escape(__version__)}</p></footer>"
