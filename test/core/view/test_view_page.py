# SPDX-FileCopyrightText: 2026 The quadpi authors
# SPDX-License-Identifier: Apache-2.0
"""The page of a bag in a real browser: what it shows, how it is moved through time, and what it survives."""

from __future__ import annotations

import base64
import os
import subprocess
import sys
import threading
from collections.abc import Iterator
from contextlib import contextmanager
from http.server import BaseHTTPRequestHandler, ThreadingHTTPServer
from pathlib import Path

import numpy as np
import pytest

from benchmarks.chromium import PROGRAM, Tab, chromium, moving_picture

from .conftest import BAG, MODEL_FOLDER

pytestmark = pytest.mark.skipif(PROGRAM is None, reason="no Chromium: apt-get install chromium")

READY = "window.quadpi?.drawn?.newest > 0"
# Set to a folder, the tests leave pictures of the page there: `make pictures`.
PICTURES = os.environ.get("QUADPI_PICTURES")


@contextmanager
def page_of(folder: Path, port: int = 0, model: Path = MODEL_FOLDER, bag: Path = BAG) -> Iterator[str]:
    """Address of the page of a bag, served by the command line."""
    command = ["view", str(bag), "--model", str(model), "--port", str(port), "--no-open"]
    with (folder / "view.err").open("w+") as errors:
        process = subprocess.Popen(
            [sys.executable, "-m", "quadpi_core.cli", *command],
            stdout=subprocess.PIPE,
            stderr=errors,
            text=True,
            env=os.environ | {"COLUMNS": "200"},
        )
        try:
            assert process.stdout is not None
            line = process.stdout.readline()
            assert "http://" in line, errors.seek(0) or errors.read()
            yield line.split()[2]
        finally:
            process.terminate()
            assert process.wait(20) == 0


@pytest.fixture(scope="module")
def tab(tmp_path_factory) -> Iterator[Tab]:
    with chromium(tmp_path_factory.mktemp("chromium")) as tab:
        yield tab


@pytest.fixture(scope="module")
def url(tmp_path_factory) -> Iterator[str]:
    with page_of(tmp_path_factory.mktemp("view")) as url:
        yield url


@pytest.fixture
def opened(tab: Tab, url: str) -> Tab:
    tab.problems.clear()
    tab.open(url)
    tab.wait(READY)
    tab.wait("quadpi.page.vehicles.get('extrapolation').newest >= 379")
    return tab


def at(tab: Tab, seconds: float) -> None:
    """Go to a moment and stay there."""
    tab.value(
        f"Object.assign(quadpi.page, {{cursor: {seconds}, playing: false, wanted: 1}}); quadpi.drawn = null"
    )
    tab.wait("quadpi.drawn !== null && quadpi.store.at(Math.floor(quadpi.page.cursor / 0.05)) !== null")
    tab.value("new Promise((done) => { quadpi.page.wanted = true; setTimeout(done, 200); })")


def test_it_plays_from_the_start_without_an_error_in_the_console(opened):
    first = opened.value("quadpi.page.cursor")
    opened.wait(f"quadpi.page.cursor > {first} + 0.5")
    assert opened.value("document.title").endswith("· quadpi")
    assert opened.value("document.getElementById('link').textContent") == "connected"
    assert opened.problems == []


def test_state_and_reason_follow_the_moment(opened):
    at(opened, 5.0)
    assert opened.value("document.getElementById('state').textContent") == "TRUSTED"
    at(opened, 10.5)
    assert opened.value("document.getElementById('state').textContent") == "ALARM"
    assert "trained up to" in opened.value("document.getElementById('reasons').textContent")
    assert "range outside" in opened.value("document.getElementById('farthest').textContent")
    assert opened.value("document.title") == "ALARM · quadpi"


def test_coverage_is_that_of_the_samples(opened, judged_view):
    at(opened, 15.0)
    shown = opened.value("quadpi.store.coverage(Math.floor(quadpi.page.cursor / 0.05), 0, 10)")
    blocks = range(300 - 200 + 1, 301)
    count = sum(judged_view.blocks.value(block, "0.count")[0] for block in blocks)
    missed = sum(judged_view.blocks.value(block, "0.misses") for block in blocks)
    assert shown["count"] == count
    assert shown["inside"] == pytest.approx(1.0 - missed / count)
    least = 100.0 * min(shown["inside"])
    for seconds in (5.0, 15.0):
        at(opened, seconds)
    assert opened.value("document.getElementById('covered10').textContent").startswith(f"{least:.1f} %")


def test_an_alarm_sounds_where_it_begins_unless_switched_off(opened):
    for sound, sounds in ((True, 1), (False, 0)):
        at(opened, 7.0)
        opened.value(f"Object.assign(quadpi.page, {{sounds: 0, sound: {str(sound).lower()}, playing: true}})")
        opened.value("document.getElementById('speed').value = '8'")
        opened.wait("document.getElementById('state').textContent === 'ALARM'")
        assert opened.value("quadpi.page.sounds") == sounds
        opened.value("document.getElementById('speed').value = '1'")


def test_an_alarm_of_any_vehicle_sounds_live_without_a_frame(opened):
    told = (
        "(() => { const page = quadpi.page;"
        "Object.assign(page, {live: true, playing: false, sound: true, sounds: 0});"
        "const told = (state) => page.socket.onmessage({data: JSON.stringify({type: 'state',"
        "vehicles: [{...page.vehicles.get('extrapolation'), state: 0}, {id: 'other', state}]})});"
        "[0, 2, 2, 1, 2].forEach(told); return page.sounds; })()"
    )
    assert opened.value(told) == 2


def test_the_first_press_lets_sounds_be_and_the_next_switches_them_off(opened):
    label = "document.getElementById('sound').textContent"
    opened.value("localStorage.removeItem('sound'); quadpi.page.sound = true")
    opened.wait(f"{label} === 'Sound on, once you click'")
    box = opened.value("document.getElementById('sound').getBoundingClientRect().toJSON()")
    place = {"x": box["x"] + 5, "y": box["y"] + 5, "button": "left", "clickCount": 1}
    for kind in ("mousePressed", "mouseReleased"):
        opened.call("Input.dispatchMouseEvent", type=kind, **place)
    opened.wait(f"{label} === 'Sound on'")
    for said in ("Sound off", "Sound on"):
        opened.press("s")
        opened.wait(f"{label} === '{said}'")
    assert opened.value("localStorage.getItem('sound')") == "on"


def test_nothing_is_saved_before_anything_is_drawn(opened):
    opened.value("quadpi.page.socket.onmessage = null; quadpi.store.clear(); quadpi.page.wanted = true")
    opened.wait("document.getElementById('csv').disabled")
    for key in "gc":
        opened.press(key)
    assert opened.problems == []


def test_charts_are_saved_as_picture_and_table(opened):
    at(opened, 10.5)
    opened.value(
        "window.made = []; window.named = []; const was = URL.createObjectURL;"
        "URL.createObjectURL = (one) => { window.made.push(one); return was(one); };"
        "HTMLAnchorElement.prototype.click = function () { window.named.push(this.download); };"
    )
    for key in "gc":
        opened.press(key)
    opened.wait("window.named.length === 2")
    assert sorted(opened.value("window.named")) == ["extrapolation-10.5s.csv", "extrapolation-10.5s.png"]
    assert opened.value("window.made.every((one) => one.size > 10000)")
    table = opened.value("window.made.find((one) => one.type === 'text/csv').text()")
    head, *rows = [line.split(",") for line in table.splitlines()]
    assert len(rows) == 211
    assert {len(row) for row in rows} == {len(head)}
    assert {"time", "measured.Fx", "inputs.u", "position.north", "rotors.4", "0.upper.Mz"} <= set(head)
    shown = opened.value("quadpi.store.value(200, 'measured', 1)")
    assert float(rows[200][head.index("measured.Fy")]) == pytest.approx(shown, rel=1e-6)


def test_the_time_of_day_is_that_of_the_stamps(opened, judged_view):
    at(opened, 10.5)
    shown = opened.value("document.getElementById('time').textContent")
    expected = opened.value(
        f"new Date(1000 * ({1e-9 * judged_view.start_ns} + 10.5)).toLocaleTimeString([], {{hour12: false}})"
    )
    assert shown == f"10.50 s · {expected}"


def test_keys_move_through_time_and_to_alarms(opened):
    at(opened, 5.0)
    opened.press("ArrowRight")
    assert opened.value("quadpi.page.cursor") == pytest.approx(6.0)
    opened.press("ArrowLeft")
    assert opened.value("quadpi.page.cursor") == pytest.approx(5.0)
    opened.press("n")
    starts = sorted(opened.value("quadpi.page.overview.events.map((event) => event.start)"))
    assert opened.value("quadpi.page.cursor") == pytest.approx(starts[0] + 1.0)
    opened.press("n")
    assert opened.value("quadpi.page.cursor") == pytest.approx(starts[1] + 1.0)
    opened.press("p")
    assert opened.value("quadpi.page.cursor") == pytest.approx(starts[0] + 1.0)
    opened.press("]")
    assert opened.value("document.getElementById('speed').value") == "2"
    opened.press("[")
    opened.press(" ")
    assert opened.value("quadpi.page.playing")
    opened.press(" ")
    assert not opened.value("quadpi.page.playing")


def test_a_click_on_an_alarm_goes_there(opened):
    opened.wait("document.querySelectorAll('#events button').length > 0")
    opened.value("document.querySelector('#events li:last-child button').click()")
    first = min(opened.value("quadpi.page.overview.events.map((event) => event.start)"))
    assert opened.value("quadpi.page.cursor") == pytest.approx(first + 1.0)
    opened.wait("document.getElementById('state').textContent === 'ALARM'")


def test_an_address_names_a_moment(tab, url):
    tab.open("about:blank")
    tab.open(f"{url}#t=10.5")
    tab.wait("quadpi.page.cursor === 10.5 && document.getElementById('state').textContent === 'ALARM'")
    assert not tab.value("quadpi.page.playing")
    tab.value("location.hash = 't=5'")
    tab.wait("quadpi.page.cursor === 5")
    tab.value("location.hash = 't=soon'")
    tab.press("ArrowRight")
    assert tab.value("quadpi.page.cursor") == 6.0
    # Beyond the end is at the end, until somebody moves.
    tab.value("location.hash = 't=1000'")
    tab.wait("quadpi.page.cursor > 18")
    tab.press("Home")
    assert tab.value("quadpi.page.cursor") == 0.0
    tab.open("about:blank")


@pytest.mark.parametrize(("width", "height"), [(1920, 1080), (1024, 768), (768, 1024), (390, 844)])
def test_it_fits_screens_from_a_phone_to_a_desk(opened, width, height):
    opened.resize(width, height)
    try:
        at(opened, 10.5)
        assert opened.value("document.documentElement.scrollWidth") <= width
        banner = opened.value("document.getElementById('banner').getBoundingClientRect().bottom")
        assert banner <= height, "the state is not seen at once"
    finally:
        opened.resize(1400, 1300)


@pytest.mark.slow
def test_a_hostile_name_is_text(tab, tmp_path):
    name = '<img src=x onerror="window.hostile=1">'
    bag = tmp_path / f"{name}.mcap"
    bag.write_bytes(BAG.read_bytes())
    model = tmp_path / '<b onclick="1">model'
    model.symlink_to(MODEL_FOLDER)
    tab.problems.clear()
    with page_of(tmp_path, bag=bag, model=model) as url:
        tab.open(url)
        tab.wait(READY)
        tab.wait("document.getElementById('models').tBodies[0].rows.length > 0")
        assert name in tab.value("document.getElementById('title').textContent")
        assert "<b onclick" in tab.value("document.getElementById('models').textContent")
        assert tab.value("document.querySelectorAll('img, [onclick]').length") == 0
        assert tab.value("window.hostile === undefined")
    assert [text for text in tab.problems if "WebSocket" not in text] == []


@pytest.mark.slow
def test_it_connects_again_after_the_server_restarts(tab, tmp_path):
    with page_of(tmp_path) as url:
        tab.open(url)
        tab.wait(READY)
    tab.wait("document.getElementById('link').classList.contains('lost')")
    assert tab.value("document.getElementById('state').textContent") == "NO DATA"
    tab.value("window.same = true")
    with page_of(tmp_path, port=int(url.rstrip("/").rpartition(":")[2])):
        tab.wait("document.getElementById('link').textContent === 'connected'")
        tab.wait("quadpi.page.vehicles.get('extrapolation')?.newest > 0 && quadpi.store.at(5) !== null")
        tab.wait("document.getElementById('state').textContent !== 'NO DATA'")
        assert tab.value("window.same")


@pytest.fixture
def elsewhere() -> Iterator[str]:
    """Another site on this machine."""

    class Site(BaseHTTPRequestHandler):
        def do_GET(self) -> None:
            self.send_response(200)
            self.send_header("Content-Type", "text/html")
            self.end_headers()
            self.wfile.write(b"<title>elsewhere</title>")

        def log_message(self, *_: object) -> None:
            pass

    # In threads: a browser opens connections that it does not use, and one server would wait for their end.
    site = ThreadingHTTPServer(("127.0.0.1", 0), Site)
    thread = threading.Thread(target=site.serve_forever)
    thread.start()
    yield f"http://localhost:{site.server_port}/"
    site.shutdown()
    thread.join()
    site.server_close()


def test_another_site_cannot_read_the_page_or_its_socket(tab, url, elsewhere):
    tab.open(elsewhere)
    tab.wait("document.title === 'elsewhere'")
    socket = url.replace("http", "ws") + "socket"
    asked = (
        f"new Promise((done) => {{ const one = new WebSocket('{socket}'); one.onmessage = () => done('read');"
        "one.onclose = () => done('refused'); })"
    )
    assert tab.value(asked) == "refused"
    assert tab.value(f"fetch('{url}view.js').then(() => 'read', () => 'refused')") == "refused"


@pytest.mark.skipif(not PICTURES, reason="pictures are made by `make pictures`")
def test_pictures_for_the_documents(opened):
    folder = Path(PICTURES or "")
    opened.resize(1400, 1010)
    at(opened, 16.5)
    (folder / "view.webp").write_bytes(opened.picture())
    frames = []
    for seconds in np.arange(7.6, 12.0, 0.7):
        at(opened, float(seconds))
        frames.append(opened.picture(scale=0.55, quality=45))
    (folder / "view-moving.webp").write_bytes(moving_picture(frames, 700))
    opened.resize(1400, 1300)


def test_a_moving_picture_is_one_that_a_browser_shows(opened):
    moving = base64.b64encode(moving_picture([opened.picture(scale=0.2) for _ in range(3)], 100)).decode()
    shown = (
        "new Promise((done) => { const one = new Image(); one.onload = () => done([one.width, one.height]);"
        f" one.onerror = () => done(null); one.src = 'data:image/webp;base64,{moving}'; }})"
    )
    assert opened.value(shown) == [280, 260]
