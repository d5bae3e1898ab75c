# SPDX-FileCopyrightText: 2026 The quadpi authors
# SPDX-License-Identifier: Apache-2.0
"""Memory of the page over ten minutes at 500 Hz in real time: of its server, and of the browser's scripts.

The baseline is what they hold when the page has all that it keeps, after three and a half minutes. Of the
browser it is the heap after a collection, with its arrays.
"""

from __future__ import annotations

import time
from contextlib import ExitStack

from benchmarks import Result, require_ros
from benchmarks.chromium import Tab, chromium, require_chromium
from benchmarks.process_usage import resident_bytes
from benchmarks.view_cost import await_port, free_port
from benchmarks.view_page import Publisher

NAMES = ("view_server_growth_mib", "view_browser_growth_mib")

MINUTES = 10.0
SETTLED_S = 210.0
_LOOK_S = 15.0


def run() -> list[Result]:
    require_ros()
    require_chromium()
    from quadpi_ros.live_session import Child, isolated_domain

    held: list[tuple[float, float, float]] = []
    with isolated_domain() as folder, ExitStack() as stack:
        port = free_port()
        server = stack.enter_context(
            Child("quadpi_ros.view_node", ("--port", str(port), "--no-open"), folder)
        )
        await_port(port)
        tab = stack.enter_context(chromium(folder))
        tab.open(f"http://127.0.0.1:{port}/")
        publisher = Publisher()
        begun_s = time.monotonic()
        while (flown_s := time.monotonic() - begun_s) < 60.0 * MINUTES:
            publisher.step(change=int(flown_s / 20.0) != int((flown_s - 0.02) / 20.0))
            if flown_s >= _LOOK_S * (1 + len(held)):
                held.append((flown_s, resident_bytes(server.pid) / 2**20, heap_mib(tab)))
            publisher.wait()
        publisher.close()
        if tab.problems:
            raise RuntimeError(f"the console of the browser says: {tab.problems[0]}")
    settled = [one for one in held if one[0] >= SETTLED_S]
    growth = [max(one[k] for one in settled) - settled[0][k] for k in (1, 2)]
    of_what = f"{MINUTES:g} minutes, three models; after {SETTLED_S:g} s"
    return [
        Result(NAMES[0], growth[0], "MiB", f"{of_what} {settled[0][1]:.0f} MiB", 5.0, True),
        Result(NAMES[1], growth[1], "MiB", f"{of_what} {settled[0][2]:.0f} MiB", 10.0, True),
    ]


def heap_mib(tab: Tab) -> float:
    """What the page's scripts hold."""
    tab.call("HeapProfiler.collectGarbage")
    used = float(tab.call("Runtime.getHeapUsage")["usedSize"])
    return (used + float(tab.value(_PAGES))) / 2**20


# Typed arrays lie outside of the heap that the browser counts.
_PAGES = "[...quadpi.store.pages.values()].reduce((sum, page) => sum + page.rows.byteLength, 0)"
