# SPDX-FileCopyrightText: 2026 The quadpi authors
# SPDX-License-Identifier: Apache-2.0
"""The page in a headless Chromium without a GPU: how late, how smooth, how heavy, how soon.

Latency is from the publication of an alarm of another level to the frame in which the page's large word has
changed, by the same clock, while three models are predicted at 500 Hz. Frames are counted while the page
redraws all it can.
"""

from __future__ import annotations

import subprocess
import sys
import tempfile
import time
from contextlib import ExitStack
from pathlib import Path

import numpy as np

from benchmarks import Result, require_ros
from benchmarks.chromium import Tab, chromium, require_chromium
from benchmarks.swings import VEHICLE, swings, three_models
from benchmarks.view_cost import await_port, free_port
from quadpi_core.frames import Array
from quadpi_core.logs.bags import write_bag
from quadpi_core.report import ASSETS, SHARED_ASSETS
from quadpi_core.vehicle import Vehicle
from quadpi_core.view.view_server import PAGE_FOLDER

NAMES = (
    "view_latency_ms",
    "view_latency_p99_ms",
    "view_frames_per_s",
    "view_page_mib",
    "view_first_picture_s",
)

CHANGES = 100
MINUTES = 10.0
FRAMES_S = 5.0
_STEP_S = 0.02
_RATE_HZ = 500
_READY = "window.quadpi?.drawn?.newest > 0"
# Notes when the word has changed and was drawn.
_OBSERVE = """
window.changes = [];
new MutationObserver(() => requestAnimationFrame(() => setTimeout(() =>
  window.changes.push([document.getElementById('state').textContent, Date.now()]))))
  .observe(document.getElementById('state'), {childList: true, characterData: true, subtree: true});
"""
_COUNT = """
new Promise((done) => {
  const begun = performance.now();
  let frames = 0;
  const next = (now) => {
    quadpi.page.wanted = true;
    frames++;
    if (now - begun > %d) done(1000 * frames / (now - begun)); else requestAnimationFrame(next);
  };
  requestAnimationFrame(next);
})
"""


def run() -> list[Result]:
    require_ros()
    require_chromium()
    latency_ms, frames_per_s = live_page()
    files = [*PAGE_FOLDER.iterdir(), *(ASSETS / name for name in SHARED_ASSETS)]
    weight = sum(path.stat().st_size for path in files)
    first_s = first_picture()
    changes = f"{len(latency_ms)} alarms that change, three models at {_RATE_HZ} Hz, software rendering"
    return [
        Result(NAMES[0], float(np.median(latency_ms)), "ms, median", changes, 100.0, True),
        Result(NAMES[1], float(np.percentile(latency_ms, 99)), "ms", changes, 300.0, True),
        Result(NAMES[2], frames_per_s, "frames/s", "6 axes of 30 s, three models, 1400 x 1300", 20.0),
        Result(NAMES[3], weight / 2**20, "MiB", "all files of the page", 1.0, True),
        Result(NAMES[4], first_s, "s", f"from the command to a bag of {MINUTES:g} minutes drawn", 3.0, True),
    ]


def live_page() -> tuple[Array, float]:
    """Latencies of alarms in ms, and frames per second."""
    from quadpi_ros.live_session import Child, isolated_domain

    with isolated_domain() as folder, ExitStack() as stack:
        port = free_port()
        stack.enter_context(Child("quadpi_ros.view_node", ("--port", str(port), "--no-open"), folder))
        await_port(port)
        tab = stack.enter_context(chromium(folder))
        tab.open(f"http://127.0.0.1:{port}/")
        published = publish(tab)
        changed = [(word, at) for word, at in tab.value("window.changes") if word in {"TRUSTED", "ALARM"}]
        frames = float(tab.value(_COUNT % (1000 * FRAMES_S)))
    seen = dict.fromkeys(range(len(published)), np.nan)
    for word, at_ms in changed:
        earlier = [k for k, (sent, at) in enumerate(published) if sent == word and 1e3 * at <= at_ms + 1.0]
        if earlier and np.isnan(seen[earlier[-1]]):
            seen[earlier[-1]] = at_ms - 1e3 * published[earlier[-1]][1]
    latency = np.array(list(seen.values()))
    if np.isnan(latency).mean() > 0.05:
        raise RuntimeError(f"{np.isnan(latency).sum()} of {len(latency)} changes were not seen")
    return latency[np.isfinite(latency)], frames


class Publisher:
    """Publishes what a monitor of three models would at 500 Hz, with stamps of this computer's clock."""

    def __init__(self) -> None:
        from quadpi.msg import ExtrapolationAlarm, WrenchPrediction
        from rclpy.context import Context
        from rclpy.node import Node

        from quadpi_ros.callbacks import OUTPUT_QOS

        self._context = Context()
        self._context.init()
        self._node = Node("publisher", context=self._context)
        names = ("prediction", "prediction/second", "prediction/third")
        self._outputs = {
            name: self._node.create_publisher(WrenchPrediction, name, OUTPUT_QOS) for name in names
        }
        self._alarms = self._node.create_publisher(ExtrapolationAlarm, "extrapolation_alarm", OUTPUT_QOS)
        self._alarm = ExtrapolationAlarm()
        self._rng = np.random.default_rng(1)
        self._begun_ns = time.time_ns()
        self._due_s = time.monotonic()
        self._next_alarm_s = self._due_s

    def step(self, change: bool = False) -> str:
        """Publish 20 ms, and the alarm when it is due or changes; gives the word that the page is to show."""
        from quadpi_core.flight import AXES
        from quadpi_core.messages.result_messages import pack_predictions
        from quadpi_core.results import Predictions

        now_ns, count = time.time_ns(), round(_STEP_S * _RATE_HZ)
        time_ns = now_ns - np.arange(count)[::-1] * (1_000_000_000 // _RATE_HZ)
        wave = np.sin(1e-9 * (time_ns - self._begun_ns)[:, None] + np.arange(6))
        noise = wave + 0.1 * self._rng.normal(size=(count, 6))
        given = Predictions(time_ns, wave, wave - 0.2, wave + 0.2, noise, np.ones((count, 6)))
        for name, output in self._outputs.items():
            for payload in pack_predictions(given, model=f"{name}@1", confidence=0.95, axes=AXES):
                output.publish(payload)
        if change or time.monotonic() >= self._next_alarm_s:
            self._next_alarm_s = time.monotonic() + 0.1
            self._alarm.level = 2 - self._alarm.level if change else self._alarm.level
            self._alarm.causes = int(self._alarm.level > 0)
            self._alarm.header.stamp.sec, self._alarm.header.stamp.nanosec = divmod(now_ns, 1_000_000_000)
            self._alarms.publish(self._alarm)
        return "ALARM" if self._alarm.level else "TRUSTED"

    def wait(self) -> None:
        """Until the next step is due."""
        self._due_s = max(self._due_s + _STEP_S, time.monotonic() - 1.0)
        time.sleep(max(0.0, self._due_s - time.monotonic()))

    def close(self) -> None:
        """Leave the domain."""
        self._node.destroy_node()
        self._context.try_shutdown()


def publish(tab: Tab) -> list[tuple[str, float]]:
    """Publish until the page is drawn, then alarms that change at random; gives each change and its time."""
    publisher, rng = Publisher(), np.random.default_rng(2)
    changes: list[tuple[str, float]] = []
    next_change_s = next_look_s = float("inf")
    next_look_s = time.monotonic() + 1.0
    while len(changes) < CHANGES or time.monotonic() < next_change_s:
        change = time.monotonic() >= next_change_s
        at_s = time.time()
        word = publisher.step(change)
        if change:
            changes.append((word, at_s))
            next_change_s = time.monotonic() + rng.uniform(0.3, 0.6)
        if time.monotonic() >= next_look_s:
            drawn = tab.value(_READY)
            next_look_s = float("inf") if drawn else time.monotonic() + 0.5
            if drawn:
                tab.value(_OBSERVE)
                next_change_s = time.monotonic() + 1.0
        publisher.wait()
    publisher.close()
    return changes


def first_picture() -> float:
    """Seconds from the command to the first blocks drawn, in a browser that runs already."""
    vehicle = Vehicle.load(VEHICLE)
    with tempfile.TemporaryDirectory() as name, chromium(Path(name)) as tab:
        folder = Path(name)
        bag = folder / "long.mcap"
        write_bag(bag, swings(vehicle, 60.0 * MINUTES))
        model = folder / next(iter(three_models(folder, vehicle).values())).name
        begun_s = time.monotonic()
        command = ["view", str(bag), "--model", str(model), "--port", "0", "--no-open"]
        process = subprocess.Popen(
            [sys.executable, "-m", "quadpi_core.cli", *command], stdout=subprocess.PIPE, text=True
        )
        try:
            assert process.stdout is not None
            tab.open(process.stdout.readline().split()[2])
            tab.wait(_READY, 60.0)
            return time.monotonic() - begun_s
        finally:
            process.terminate()
            process.wait()
