# SPDX-FileCopyrightText: 2026 The quadpi authors
# SPDX-License-Identifier: Apache-2.0
"""Damaged files and what they may do: hypothesis strategies, and the check of what came of them."""

from __future__ import annotations

import struct
import tracemalloc
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from typing import Any

from hypothesis import HealthCheck, settings
from hypothesis import strategies as st

from benchmarks.fuzzing.mutation import EXTREME_INTEGERS, WRONG_VALUES
from quadpi_core.errors import QuadpiError

# Small files: whatever takes more than this for one was told a size by the file, and believed it.
MEMORY_MAX = 100 * 2**20


def bounded(examples: int) -> Callable[[Any], Any]:
    """Hypothesis with the same examples in every run; the number of them is what bounds the time."""
    return settings(
        max_examples=examples,
        deadline=None,
        database=None,
        derandomize=True,
        suppress_health_check=list(HealthCheck),
    )


_WRONG = st.sampled_from(WRONG_VALUES)


@st.composite
def damaged(draw: st.DrawFn, whole: bytes, changes: int = 3) -> bytes:
    """The bytes with one to a few changes: cut, flipped, overwritten, taken out, doubled, other lengths."""
    data = bytearray(whole)
    for _ in range(draw(st.integers(1, changes))):
        place = draw(st.integers(0, max(len(data) - 1, 0)))
        kind = draw(st.sampled_from(("flip", "overwrite", "length", "cut", "take out", "double", "insert")))
        if kind == "flip" and data:
            data[place] ^= 1 << draw(st.integers(0, 7))
        elif kind == "overwrite":
            noise = draw(st.binary(min_size=1, max_size=16))
            data[place : place + len(noise)] = noise
        elif kind == "length":
            form = draw(st.sampled_from(("<B", "<H", "<I", "<Q")))
            size = struct.calcsize(form)
            data[place : place + size] = struct.pack(
                form, draw(st.sampled_from(EXTREME_INTEGERS)) % 256**size
            )
        elif kind == "cut":
            del data[place:]
        elif kind == "take out":
            del data[place : place + draw(st.integers(1, 64))]
        elif kind == "double":
            end = place + draw(st.integers(1, 64))
            data[end:end] = data[place:end]
        else:
            data[place:place] = draw(st.binary(min_size=1, max_size=16))
    return bytes(data)


@contextmanager
def refusing(*names: object) -> Iterator[None]:
    """What is inside works, or raises a QuadpiError of one line that names all `names`; in little memory."""
    tracemalloc.start()
    try:
        yield
    except QuadpiError as error:
        text = str(error)
        assert "\n" not in text
        assert len(text) < 2000
        for name in names:
            assert str(name) in text, text
    finally:
        _, peak = tracemalloc.get_traced_memory()
        tracemalloc.stop()
    assert peak < MEMORY_MAX


@st.composite
def altered(draw: st.DrawFn, content: Any) -> Any:
    """JSON or YAML content in which something is another value, absent, there twice, or added."""
    if isinstance(content, dict) and content and draw(st.integers(0, 9)):
        key = draw(st.sampled_from(sorted(content)))
        return {**content, key: draw(altered(content[key]))}
    if isinstance(content, list) and content and draw(st.integers(0, 9)):
        index = draw(st.integers(0, len(content) - 1))
        return [*content[:index], draw(altered(content[index])), *content[index + 1 :]]
    kind = draw(st.sampled_from(("replace", "shrink", "grow", "scale")))
    if kind == "shrink" and isinstance(content, dict | list) and content:
        if isinstance(content, list):
            return content[1:]
        return {key: value for key, value in content.items() if key != draw(st.sampled_from(sorted(content)))}
    if kind == "grow" and isinstance(content, list):
        return [*content, *(content[:1] or [1.0])]
    if kind == "grow" and isinstance(content, dict):
        return {**content, "unknown": draw(_WRONG)}
    if kind == "scale" and isinstance(content, int | float):
        return content * draw(st.sampled_from((-1, 0, 2, 1000, 1e200)))
    return draw(_WRONG)
