# SPDX-FileCopyrightText: 2026 The quadpi authors
# SPDX-License-Identifier: Apache-2.0
"""The server answers its own page alone, and waits for no browser."""

from __future__ import annotations

import asyncio
import json
import os
import re
import socket
import struct
import webbrowser
from collections.abc import Awaitable, Callable
from typing import Any

import numpy as np
import pytest
from tornado.httpclient import AsyncHTTPClient, HTTPClientError, HTTPRequest
from tornado.websocket import WebSocketClientConnection, websocket_connect

from quadpi_core.flight import AXES
from quadpi_core.report import ASSETS, SHARED_ASSETS
from quadpi_core.view import view_server
from quadpi_core.view.trust import State
from quadpi_core.view.vehicle_view import BLOCK_NS, VehicleView
from quadpi_core.view.view_server import (
    ViewError,
    ViewServer,
    allowed_host,
    announce,
    packed_blocks,
    same_origin,
    serve_page,
)

from .test_vehicle_view import START, predictions

HOSTILE = '<img src=x onerror="alert(1)">'


class Given:
    """A source whose vehicles the test feeds."""

    title = "given"

    def __init__(self, live: bool = True) -> None:
        self.live = live
        self.vehicles = {"uav": VehicleView("uav", {}, BLOCK_NS, 2000)}
        self.polls = 0
        self.closed = False

    def poll(self) -> None:
        self.polls += 1

    def close(self) -> None:
        self.closed = True

    def feed(self, first_s: float, seconds: float) -> None:
        given = predictions(seconds, START + round(1e9 * first_s))
        self.vehicles["uav"].take_predictions("m", given, "m@1", 0.95, AXES)


def serving(scenario: Callable[[ViewServer, Given], Awaitable[None]], source: Given | None = None) -> None:
    async def run() -> None:
        given = source or Given()
        server = ViewServer(given, 0)
        try:
            await asyncio.wait_for(scenario(server, given), 30.0)
        finally:
            server.close()
        assert given.closed

    asyncio.run(run())


async def page_of(server: ViewServer, **headers: str) -> WebSocketClientConnection:
    return await websocket_connect(HTTPRequest(f"{server.url.replace('http', 'ws')}socket", headers=headers))


async def received(page: WebSocketClientConnection, kind: str) -> Any:
    """The next message of a type; `blocks` for a binary one."""
    while True:
        message = await page.read_message()
        assert message is not None
        if isinstance(message, bytes):
            if kind == "blocks":
                length = struct.unpack_from("<I", message)[0]
                head = json.loads(message[4 : 4 + length])
                rows = np.frombuffer(message, "<f4", offset=4 + length)
                return head, rows.reshape(head["count"], -1)
        elif (content := json.loads(message))["type"] == kind:
            return content


@pytest.mark.parametrize(
    ("host", "bound", "allowed"),
    [
        ("127.0.0.1:8710", "127.0.0.1", True),
        ("localhost:9999", "127.0.0.1", True),
        ("LOCALHOST", "127.0.0.1", True),
        ("[::1]:8710", "127.0.0.1", True),
        ("evil.example:8710", "127.0.0.1", False),
        ("evil.example", "0.0.0.0", False),
        ("127.0.0.1.evil.example", "127.0.0.1", False),
        ("localhost.evil.example", "127.0.0.1", False),
        ("192.168.1.5:8710", "127.0.0.1", False),
        ("192.168.1.5:8710", "0.0.0.0", True),
        (f"{socket.gethostname()}:8710", "0.0.0.0", True),
        (f"{socket.gethostname()}.", "127.0.0.1", False),
        ("", "127.0.0.1", False),
        ("[::1", "127.0.0.1", False),
        ("127.0.0.1:x", "127.0.0.1", False),
    ],
)
def test_only_names_of_this_server_are_answered(host, bound, allowed):
    assert allowed_host(host, bound) is allowed


@pytest.mark.parametrize(
    ("origin", "host", "same"),
    [
        (None, "127.0.0.1:8710", True),
        ("http://127.0.0.1:8710", "127.0.0.1:8710", True),
        ("http://127.0.0.1:9999", "127.0.0.1:8710", False),
        ("http://evil.example", "127.0.0.1:8710", False),
        ("null", "127.0.0.1:8710", False),
        ("file://", "127.0.0.1:8710", False),
        ("", "127.0.0.1:8710", False),
    ],
)
def test_only_the_own_page_gets_a_websocket(origin, host, same):
    assert same_origin(origin, host) is same


def test_pages_of_other_names_and_origins_are_refused():
    async def scenario(server: ViewServer, _: Given) -> None:
        client = AsyncHTTPClient()
        answer = await client.fetch(server.url)
        assert b"<title>quadpi</title>" in answer.body
        assert "script-src 'self'" in answer.headers["Content-Security-Policy"]
        assert "Access-Control-Allow-Origin" not in answer.headers
        for path, headers in (
            ("", {"Host": "evil.example"}),
            ("view.js", {"Host": "evil.example"}),
            ("socket", {"Host": "evil.example", "Upgrade": "websocket", "Connection": "Upgrade"}),
        ):
            with pytest.raises(HTTPClientError, match="403"):
                await client.fetch(HTTPRequest(server.url + path, headers=headers))
        for headers in ({"Origin": "http://evil.example"}, {"Origin": "null"}, {"Host": "evil.example"}):
            with pytest.raises(HTTPClientError, match="403"):
                await page_of(server, **headers)

    serving(scenario)


@pytest.mark.parametrize(
    "path", ["../blocks.py", "..%2fblocks.py", "%2e%2e/blocks.py", "nothing.js", "/etc/passwd"]
)
def test_nothing_but_the_page_is_served(path):
    async def scenario(server: ViewServer, _: Given) -> None:
        with pytest.raises(HTTPClientError, match=r"40[34]"):
            await AsyncHTTPClient().fetch(server.url + path)

    serving(scenario)


def test_a_page_is_told_of_the_vehicle_and_then_what_is_new():
    async def scenario(server: ViewServer, source: Given) -> None:
        source.feed(0.0, 1.0)
        page = await page_of(server)
        assert (await received(page, "hello"))["live"] is True
        (vehicle,) = (await received(page, "state"))["vehicles"]
        assert vehicle["id"] == "uav"
        assert vehicle["newest"] == 19
        await page.write_message(json.dumps({"select": "uav"}))
        described = await received(page, "vehicle")
        assert described["columns"]["0.count"] == list(source.vehicles["uav"].blocks.columns["0.count"])
        assert (await received(page, "overview"))["id"] == "uav"
        source.feed(1.0, 0.5)
        head, rows = await received(page, "blocks")
        assert head["first"] <= 20
        assert head["first"] + head["count"] == 30
        np.testing.assert_array_equal(rows, source.vehicles["uav"].window(head["first"], 29)[1])

    serving(scenario)


def test_a_page_that_comes_later_gets_what_its_charts_and_shares_cover():
    async def scenario(server: ViewServer, source: Given) -> None:
        source.feed(0.0, 90.0)
        await asyncio.sleep(0.2)
        page = await page_of(server)
        await page.write_message(json.dumps({"select": "uav"}))
        head, rows = await received(page, "blocks")
        assert head["first"] + head["count"] == 1800
        assert head["count"] * BLOCK_NS >= 60e9
        np.testing.assert_array_equal(rows, source.vehicles["uav"].window(head["first"], 1799)[1])

    serving(scenario)


def test_blocks_of_another_time_are_sent_when_asked_for():
    async def scenario(server: ViewServer, source: Given) -> None:
        source.feed(0.0, 20.0)
        page = await page_of(server)
        await page.write_message(json.dumps({"select": "uav"}))
        await received(page, "overview")
        await page.write_message(json.dumps({"id": "uav", "blocks": [100, 149]}))
        head, rows = await received(page, "blocks")
        assert (head["first"], head["count"]) == (100, 50)
        np.testing.assert_array_equal(rows, source.vehicles["uav"].window(100, 149)[1])

    serving(scenario, Given(live=False))


@pytest.mark.parametrize(
    "wish",
    [
        "",
        "[]",
        "{",
        '{"blocks": [1]}',
        '{"blocks": ["a", 2], "id": "uav"}',
        '{"blocks": [1e400, 2], "id": "uav"}',
        "5",
    ],
)
def test_a_wish_that_is_none_ends_that_page_alone(wish):
    async def scenario(server: ViewServer, source: Given) -> None:
        good, bad = await page_of(server), await page_of(server)
        await bad.write_message(wish)
        while await bad.read_message() is not None:
            pass
        await good.write_message(json.dumps({"select": "uav"}))
        assert (await received(good, "vehicle"))["id"] == "uav"
        assert len(server.pages) == 1
        # As is a wish for what there is not.
        await good.write_message(json.dumps({"id": "uav", "blocks": [-(10**30), 10**30]}))
        await good.write_message(json.dumps({"select": HOSTILE}))
        source.feed(0.0, 0.1)
        await received(good, "state")

    serving(scenario)


def test_a_browser_that_takes_nothing_holds_no_one_up_and_is_let_go(monkeypatch):
    monkeypatch.setattr(view_server, "PATIENCE_S", 1.0)

    async def scenario(server: ViewServer, source: Given) -> None:
        sleeper = socket.create_connection(("127.0.0.1", server.port))
        sleeper.setsockopt(socket.SOL_SOCKET, socket.SO_RCVBUF, 4096)
        sleeper.sendall(
            f"GET /socket HTTP/1.1\r\nHost: 127.0.0.1:{server.port}\r\nUpgrade: websocket\r\n"
            "Connection: Upgrade\r\nSec-WebSocket-Version: 13\r\n"
            "Sec-WebSocket-Key: dGhlIHNhbXBsZSBub25jZQ==\r\n\r\n".encode()
        )
        while not server.pages:
            await asyncio.sleep(0.01)
        (asleep,) = server.pages
        asleep.on_message(json.dumps({"select": "uav"}))
        awake = await page_of(server)
        await awake.write_message(json.dumps({"select": "uav"}))
        second = 0.0
        while asleep in server.pages:
            # All blocks change again and again: megabytes for a browser that takes none.
            source.feed(second % 60.0, 60.0)
            second += 60.0
            await received(awake, "blocks")
        source.feed(second + 60.0, 1.0)
        await received(awake, "blocks")
        sleeper.close()

    serving(scenario)


def test_hostile_names_and_numbers_are_valid_json():
    source = Given()
    source.vehicles = {HOSTILE: VehicleView(HOSTILE, {}, BLOCK_NS, 100)}
    broken = predictions(0.1)
    broken.predicted[:] = np.nan
    source.vehicles[HOSTILE].take_predictions(HOSTILE, broken, "\u2028</script>", np.nan, AXES)

    async def scenario(server: ViewServer, _: Given) -> None:
        page = await page_of(server)
        await page.write_message(json.dumps({"select": HOSTILE}))
        (model,) = (await received(page, "vehicle"))["models"]
        assert model == {
            "name": HOSTILE,
            "identity": "\u2028</script>",
            "confidence": None,
            "axes": list(AXES),
            "vehicle": None,
        }

    serving(scenario, source)


def test_rows_are_aligned_for_the_browser():
    view = Given().vehicles["uav"]
    for name in ("m", "longer", "another one"):
        view.take_predictions(name, predictions(0.1), f"{name}@1", 0.95, AXES)
        assert struct.unpack_from("<I", packed_blocks(view, 0, 1))[0] % 4 == 0


def test_a_port_in_use_is_refused_naming_who_has_it():
    async def scenario(server: ViewServer, _: Given) -> None:
        with pytest.raises(
            ViewError, match=rf"port {server.port} is in use by process {os.getpid()} .*--port"
        ):
            ViewServer(Given(), server.port)

    serving(scenario)


def test_an_address_that_is_not_here_is_refused():
    async def scenario(_: ViewServer, __: Given) -> None:
        with pytest.raises(ViewError, match=r"cannot listen on 203\.0\.113\.1 port 8710"):
            ViewServer(Given(), 8710, "203.0.113.1")

    serving(scenario)


def test_the_page_is_small_and_needs_nothing_from_elsewhere():
    files = {path.name: path for path in (view_server.PAGE_FOLDER).iterdir()}
    files |= {name: ASSETS / name for name in SHARED_ASSETS}
    own = {"index.html", "view.css", "view.js", "store.js", "charts.js", "export.js"}
    assert set(files) == {*own, *SHARED_ASSETS}
    assert sum(path.stat().st_size for path in files.values()) < 1 << 20
    del files["uPlot.js"]
    for path in files.values():
        # The name space of SVG is no address that is read.
        text = path.read_text().replace("http://www.w3.org/2000/svg", "")
        assert not re.search(
            r"https?://|innerHTML|outerHTML|insertAdjacent|document\.write|\beval\b", text
        ), path


def test_it_serves_until_told_to_end():
    said: list[str] = []
    source = Given()
    serve_page(source, 0, "127.0.0.1", said.append, until=lambda: source.polls > 3)
    assert re.fullmatch(r"http://127\.0\.0\.1:\d+/", said[0])
    assert source.closed
    assert source.vehicles["uav"].state == State.NO_DATA


@pytest.mark.parametrize(
    ("display", "wish", "opened"),
    [(None, None, False), (":0", None, True), (":0", False, False), (None, True, True)],
)
def test_page_is_opened_where_somebody_looks(monkeypatch, display, wish, opened):
    for name in ("DISPLAY", "WAYLAND_DISPLAY"):
        monkeypatch.delenv(name, raising=False)
    if display:
        monkeypatch.setenv("DISPLAY", display)
    shown: list[str] = []
    said: list[str] = []
    monkeypatch.setattr(webbrowser, "open", shown.append)
    announce(said.append, "http://127.0.0.1:8710/", wish)
    assert "http://127.0.0.1:8710/" in said[0]
    assert shown == (["http://127.0.0.1:8710/"] if opened else [])
