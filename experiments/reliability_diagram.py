# SPDX-FileCopyrightText: 2026 The quadpi authors
# SPDX-License-Identifier: Apache-2.0
"""Reliability diagram of searches: what was named with a probability, and how often it was hidden.

Only names of the verdict "effects" count, those on flights without an effect or with one outside the library
included. Written as SVG with the same bytes for the same results.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from pathlib import Path
from typing import Any, NamedTuple

from blind.scoring import Answer, wilson
from page_tables import RESULTS

from quadpi_core.paths import whole_output

IMAGES = RESULTS / "images"
# Upper ends of the groups of probabilities: nearly all are close to 1, so the groups go by odds.
ENDS = (0.5, 0.9, 0.99, 0.999, 1.0)
_WIDTH, _HEIGHT, _LEFT, _TOP, _RIGHT, _BOTTOM = 560.0, 330.0, 64.0, 40.0, 16.0, 66.0
_PAPER, _INK, _SOFT, _RULE, _BLUE = "#ffffff", "#14191f", "#4a5560", "#cbd2d9", "#0072b2"


class Named(NamedTuple):
    """One effect that a search named: with which probability, and whether it was hidden."""

    probability: float
    hidden: bool


class Group(NamedTuple):
    """Names within a range of probabilities.

    Attributes:
        low, high: the range; above `low`, up to `high`.
        said: mean probability; 0 of no names.
        hits: number of those that were hidden.
        of: number of names.
    """

    low: float
    high: float
    said: float
    hits: int
    of: int

    @property
    def words(self) -> str:
        """The range in percent."""
        high = "100" if self.high == 1.0 else f"{100.0 * self.high:g}"
        return f"{100.0 * self.low:g} – {high} %"


def named(results: Iterable[Mapping[str, Any]]) -> list[Named]:
    """Every name of results that :func:`blind.searching.searched` gives, with the seals opened."""
    found = []
    for result in results:
        answer = Answer.of(result, {})
        if answer.verdict == "effects":
            found += [
                Named(effect["probability"], effect["name"] in answer.hidden.effects)
                for effect in result["result"]["effects"]
            ]
    return found


def groups(names: Sequence[Named]) -> list[Group]:
    """Names by their probability."""
    found = []
    for low, high in zip((0.0, *ENDS[:-1]), ENDS, strict=True):
        own = [name for name in names if low < name.probability <= high or (low == name.probability == 0.0)]
        said = sum(name.probability for name in own) / len(own) if own else 0.0
        found.append(Group(low, high, said, sum(name.hidden for name in own), len(own)))
    return found


def diagram(names: Sequence[Named], title: str) -> str:
    """The diagram as SVG."""
    parts = [
        f'<svg xmlns="http://www.w3.org/2000/svg" viewBox="0 0 {_WIDTH:g} {_HEIGHT:g}" '
        'font-family="sans-serif" font-size="13">',
        f"<title>{title}</title>",
        f'<rect width="{_WIDTH:g}" height="{_HEIGHT:g}" fill="{_PAPER}"/>',
        _text(_LEFT, 22.0, title, anchor="start", weight="bold"),
    ]
    for share in (0.0, 0.25, 0.5, 0.75, 1.0):
        parts.append(_line(_LEFT, _y(share), _WIDTH - _RIGHT, _y(share), _RULE, 1.0))
        parts.append(_text(_LEFT - 8.0, _y(share) + 4.5, f"{100.0 * share:.0f} %", anchor="end"))
    width = (_WIDTH - _LEFT - _RIGHT) / len(ENDS)
    for place, group in enumerate(groups(names)):
        x = _LEFT + (place + 0.5) * width
        parts.append(_text(x, _HEIGHT - _BOTTOM + 20.0, group.words))
        parts.append(_text(x, _HEIGHT - _BOTTOM + 37.0, f"{group.hits} / {group.of}", colour=_SOFT))
        if not group.of:
            continue
        low, high = wilson(group.hits, group.of)
        parts.append(_line(x - 26.0, _y(group.said), x + 26.0, _y(group.said), _INK, 2.0, "5 3"))
        parts.append(_line(x, _y(low), x, _y(high), _BLUE, 3.0))
        parts.append(f'<circle cx="{x:.1f}" cy="{_y(group.hits / group.of):.1f}" r="6" fill="{_BLUE}"/>')
    legend = (
        "dot: share that was hidden, with its interval of 95 %; dashed: what was said; below: hidden / named"
    )
    parts += [_text(_WIDTH / 2.0, _HEIGHT - 8.0, legend, colour=_SOFT, size=10.5), "</svg>", ""]
    return "\n".join(parts)


def write_diagram(path: Path, results: Iterable[Mapping[str, Any]], title: str) -> None:
    """Write the diagram of results; it appears whole or not at all."""
    with whole_output(path) as temporary:
        temporary.write_text(diagram(named(results), title), encoding="utf-8")


def _y(share: float) -> float:
    return _TOP + (1.0 - share) * (_HEIGHT - _TOP - _BOTTOM)


def _line(x1: float, y1: float, x2: float, y2: float, colour: str, width: float, dash: str = "") -> str:
    dashed = f' stroke-dasharray="{dash}"' if dash else ""
    return (
        f'<line x1="{x1:.1f}" y1="{y1:.1f}" x2="{x2:.1f}" y2="{y2:.1f}" stroke="{colour}" '
        f'stroke-width="{width:g}"{dashed}/>'
    )


def _text(
    x: float,
    y: float,
    text: str,
    *,
    anchor: str = "middle",
    colour: str = _INK,
    weight: str = "normal",
    size: float = 13.0,
) -> str:
    return (
        f'<text x="{x:.1f}" y="{y:.1f}" text-anchor="{anchor}" fill="{colour}" font-weight="{weight}" '
        f'font-size="{size:g}">{text}</text>'
    )
