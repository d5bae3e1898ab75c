# SPDX-FileCopyrightText: 2026 The quadpi authors
# SPDX-License-Identifier: Apache-2.0
"""Damaged files and what they may do: hypothesis strategies, and the check of what came of them."""

from __future__ import annotations

import random
import tracemalloc
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from typing import Any

from hypothesis import HealthCheck, settings
from hypothesis import strategies as st

from benchmarks.fuzzing.mutation import alter, mutate
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


_SEEDS = st.integers(0, 2**32 - 1)


def damaged(whole: bytes) -> st.SearchStrategy[bytes]:
    """The bytes with a few changes, as `make fuzz` makes them."""
    return _SEEDS.map(lambda seed: mutate(random.Random(seed), whole, None, [whole]))


def altered(content: Any) -> st.SearchStrategy[Any]:
    """JSON or YAML content in which something is another value, absent, repeated or out of scale."""
    return _SEEDS.map(lambda seed: alter(random.Random(seed), content))


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
