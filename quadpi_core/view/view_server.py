# SPDX-FileCopyrightText: 2026 The quadpi authors
# SPDX-License-Identifier: Apache-2.0
"""The server of the page: static files, and a websocket for each browser that is never waited for.

A browser that is slow or dead is left out until it has taken what it was sent; then it gets what it missed,
as far as that is kept. What waits for a browser is one tick's messages at most, however long it sleeps.
"""

from __future__ import annotations

import asyncio
import errno
import ipaddress
import json
import os
import re
import socket
import struct
import time
import webbrowser
from collections.abc import Callable
from contextlib import suppress
from pathlib import Path
from typing import TYPE_CHECKING, Any
from urllib.parse import urlsplit

from tornado.httpserver import HTTPServer
from tornado.ioloop import PeriodicCallback
from tornado.netutil import bind_sockets
from tornado.web import Application, HTTPError, RequestHandler, StaticFileHandler
from tornado.websocket import WebSocketClosedError, WebSocketHandler

from quadpi_core.errors import QuadpiError
from quadpi_core.paths import finite_json
from quadpi_core.report import ASSETS, SHARED_ASSETS
from quadpi_core.version import __version__
from quadpi_core.view.vehicle_view import VehicleView

if TYPE_CHECKING:
    from quadpi_core.view.rerun_recording import Source

PORT, ADDRESS = 8710, "127.0.0.1"
PAGE_FOLDER = Path(__file__).with_name("page")
TICK_S = 0.05
# Whole sessions are sent at this rate, and health.
OVERVIEW_S = 1.0
# A browser that takes nothing for this long is let go; it connects again when it wakes up.
PATIENCE_S = 10.0
# Blocks in one message: 75 s, what the longest coverage needs.
_BLOCKS_MAX = 1500
_REQUEST_BYTES_MAX = 4096
_LOOPBACK_NAMES = ("localhost",)
_POLICY = (
    "default-src 'none'; script-src 'self'; style-src 'self'; img-src 'self' data:; connect-src 'self'; "
    "base-uri 'none'; form-action 'none'; frame-ancestors 'none'"
)


class ViewError(QuadpiError):
    """The page cannot be served."""


def allowed_host(host: str, bound: str) -> bool:
    """Whether a request that names this host is for this server.

    Another name that resolves to this address is how a page of another site would reach it (DNS rebinding),
    so names are refused but for that of the machine, where the server is bound beyond it. Any port is
    accepted, as of a tunnel.

    Args:
        host: header of the request, with or without a port.
        bound: address that the server listens on.
    """
    try:
        name = urlsplit(f"//{host}").hostname or ""
        _ = urlsplit(f"//{host}").port
    except ValueError:
        return False
    try:
        address = ipaddress.ip_address(name)
    except ValueError:
        beyond = not _is_loopback(bound)
        return name in _LOOPBACK_NAMES or (beyond and name in {socket.gethostname().lower(), bound.lower()})
    return address.is_loopback or not _is_loopback(bound)


def same_origin(origin: str | None, host: str) -> bool:
    """Whether a websocket is asked for by a page of this server; no origin means that no browser asks."""
    if origin is None:
        return True
    parts = urlsplit(origin)
    return parts.scheme in {"http", "https"} and parts.netloc.lower() == host.lower()


def _is_loopback(address: str) -> bool:
    try:
        return ipaddress.ip_address(address).is_loopback
    except ValueError:
        return address in _LOOPBACK_NAMES


def packed_blocks(view: VehicleView, first: int, last: int) -> bytes:
    """A message of blocks: length of a JSON head, the head, and the rows as little-endian float32."""
    begin, rows, words = view.window(first, last)
    head = {"id": view.name, "version": view.version, "first": begin, "count": len(rows), "words": words}
    text = _as_json(head).encode()
    text += b" " * (-len(text) % 4)
    return struct.pack("<I", len(text)) + text + rows.astype("<f4", copy=False).tobytes()


def _as_json(message: Any) -> str:
    """JSON where a number that is not finite is null: a hostile message may hold one, and JSON knows none."""
    try:
        return json.dumps(message, separators=(",", ":"), allow_nan=False)
    except ValueError:
        return json.dumps(finite_json(message), separators=(",", ":"), allow_nan=False)


class ViewServer:
    """Serves the page of a source; to be used within a running event loop.

    Args:
        source: of the data.
        port: to listen on; 0 takes any that is free.
        address: to listen on.

    Raises:
        ViewError: if the port is taken, naming who has it.
    """

    def __init__(self, source: Source, port: int = PORT, address: str = ADDRESS) -> None:
        self.source = source
        self.address = address
        self.pages: set[_Page] = set()
        self.failure: Exception | None = None
        self._overview_s = 0.0
        page, shared = str(PAGE_FOLDER), "|".join(map(re.escape, SHARED_ASSETS))
        self._http = HTTPServer(
            Application(
                [
                    (r"/socket", _Page, {"server": self}),
                    (r"/()", _Static, {"path": page, "default_filename": "index.html"}),
                    (rf"/({shared})", _Static, {"path": str(ASSETS)}),
                    (r"/(.*)", _Static, {"path": page}),
                ],
                bound=address,
                websocket_max_message_size=_REQUEST_BYTES_MAX,
            ),
            max_buffer_size=1 << 16,
        )
        try:
            sockets = bind_sockets(port, address)
        except (OSError, UnicodeError) as error:
            raise ViewError(_why_not(error, port, address)) from error
        self._http.add_sockets(sockets)
        self.port: int = sockets[0].getsockname()[1]
        self._ticks = PeriodicCallback(self._tick, 1e3 * TICK_S)
        self._ticks.start()

    @property
    def url(self) -> str:
        """Address of the page."""
        host = self.address if ":" not in self.address else f"[{self.address}]"
        host = "127.0.0.1" if host == "0.0.0.0" else "[::1]" if host == "[::]" else host
        return f"http://{host}:{self.port}/"

    def close(self) -> None:
        """Stop serving."""
        self._ticks.stop()
        self._http.stop()
        for page in list(self.pages):
            page.close(1001, "the server ends")
        self.source.close()

    def hello(self) -> dict[str, Any]:
        """What a page is told first."""
        return {"type": "hello", "version": __version__, "live": self.source.live, "title": self.source.title}

    def _tick(self) -> None:
        try:
            self._serve_what_is_new()
        except Exception as error:
            # An error in the program: whoever started the server is to know, at once and only once.
            self._ticks.stop()
            self.failure = error

    def _serve_what_is_new(self) -> None:
        self.source.poll()
        views = dict(self.source.vehicles)
        now_s = time.monotonic()
        overview = now_s - self._overview_s >= OVERVIEW_S
        if overview:
            self._overview_s = now_s
        changed = {name: view.blocks.take_changed() for name, view in views.items()}
        if not self.pages:
            return
        summary = _as_json({"type": "state", "vehicles": [view.summary() for view in views.values()]})
        for page in list(self.pages):
            page.tick(now_s, summary, views, changed, overview)


class _Static(StaticFileHandler):
    """The page's own files."""

    def prepare(self) -> None:
        _require_host(self, self.settings["bound"])

    def set_extra_headers(self, path: str) -> None:  # noqa: ARG002
        self.set_header("Content-Security-Policy", _POLICY)
        self.set_header("X-Content-Type-Options", "nosniff")
        self.set_header("Cross-Origin-Resource-Policy", "same-origin")
        self.set_header("Referrer-Policy", "no-referrer")
        # A page of an older version would not understand a newer server.
        self.set_header("Cache-Control", "no-cache")


def _require_host(handler: RequestHandler, bound: str) -> None:
    if not allowed_host(handler.request.host, bound):
        raise HTTPError(403, "not a name of this server")


class _Page(WebSocketHandler):
    """One browser."""

    def initialize(self, server: ViewServer) -> None:
        self._server = server
        self._selected = ""
        self._told: dict[str, int] = {}
        self._state = ""
        self._missed_from: int | None = None
        self._on_its_way: asyncio.Future[None] | None = None
        self._sent_s = time.monotonic()
        self._wants_overview = True
        self._asked: list[tuple[str, int, int]] = []

    def prepare(self) -> None:
        _require_host(self, self.settings["bound"])

    def check_origin(self, origin: str) -> bool:
        """Whether a page of this server asks."""
        return same_origin(origin, self.request.host)

    def open(self, *_: str, **__: str) -> None:
        """Register the client."""
        self.set_nodelay(True)
        self._server.pages.add(self)
        self._send(self._server.hello())

    def on_close(self) -> None:
        """Forget the client."""
        self._server.pages.discard(self)

    def on_message(self, message: str | bytes) -> None:
        """Take a request: another vehicle, or blocks of another time. Anything else ends the connection."""
        try:
            request = json.loads(message)
            if not isinstance(request, dict):
                raise TypeError
            if "select" in request:
                self._selected = str(request["select"])
                self._told.pop(self._selected, None)
                self._wants_overview = True
            if "blocks" in request:
                first, last = request["blocks"]
                self._asked = [*self._asked, (str(request["id"]), int(first), int(last))][-8:]
        except (ValueError, TypeError, KeyError, AttributeError, OverflowError):
            self.close(1003, "invalid request")

    def tick(
        self,
        now_s: float,
        summary: str,
        views: dict[str, VehicleView],
        changed: dict[str, int | None],
        overview: bool,
    ) -> None:
        """Send what is new, if all before has been taken."""
        view = views.get(self._selected)
        since = changed.get(self._selected)
        if since is not None:
            self._missed_from = since if self._missed_from is None else min(since, self._missed_from)
        self._wants_overview |= overview
        if self._on_its_way is not None and not self._on_its_way.done():
            if now_s - self._sent_s > PATIENCE_S:
                self.close(1001, "took nothing for too long")
                self._server.pages.discard(self)
            return
        self._sent_s = now_s
        if summary != self._state:
            self._state = summary
            self._send(summary)
        if view is None:
            return
        if self._told.get(view.name) != view.version:
            self._told[view.name] = view.version
            # Of a live vehicle, all that its charts and shares cover.
            self._missed_from = 0
            self._send({"type": "vehicle", "version": view.version, **view.describe()})
        if self._missed_from is not None and self._server.source.live:
            first = max(self._missed_from, view.blocks.newest + 1 - _BLOCKS_MAX)
            self._send(packed_blocks(view, first, view.blocks.newest))
        self._missed_from = None
        if self._asked:
            name, first, last = self._asked.pop(0)
            if (asked := views.get(name)) is not None:
                self._send(packed_blocks(asked, max(0, first), min(last, first + _BLOCKS_MAX)))
        if self._wants_overview:
            self._wants_overview = False
            self._send({"type": "overview", **view.overview()})

    def _send(self, message: dict[str, Any] | str | bytes) -> None:
        try:
            text = _as_json(message) if isinstance(message, dict) else message
            self._on_its_way = self.write_message(text, isinstance(text, bytes))
            # A browser that is gone is no error.
            self._on_its_way.add_done_callback(lambda sent: sent.cancelled() or sent.exception())
        except WebSocketClosedError:
            self._server.pages.discard(self)


def port_problem(port: int = PORT, address: str = ADDRESS) -> str | None:
    """Why a page cannot be served there, naming who has the port; None if it can."""
    try:
        for one in bind_sockets(port, address):
            one.close()
    except (OSError, UnicodeError) as error:
        return _why_not(error, port, address)
    return None


def _why_not(error: OSError | UnicodeError, port: int, address: str) -> str:
    number = getattr(error, "errno", None)
    if number == errno.EADDRINUSE:
        return f"port {port} is in use{_user_of(port)}; give another with --port"
    if number == errno.EACCES:
        return f"port {port} needs the rights of root; give one above 1023 with --port"
    return f"cannot listen on {address} port {port}: {getattr(error, 'strerror', None) or error}"


# State of a socket in /proc/net/tcp.
_LISTENS = "0A"


def _user_of(port: int) -> str:
    """Who listens on a port, as far as this user may know."""
    sockets = set()
    for table in ("/proc/net/tcp", "/proc/net/tcp6"):
        with suppress(OSError):
            for line in Path(table).read_text().splitlines()[1:]:
                _, local, _, state, _, _, _, _, _, inode, *_ = line.split()
                if state == _LISTENS and int(local.rpartition(":")[2], 16) == port:
                    sockets.add(f"socket:[{inode}]")
    if not sockets:
        return ""
    for link in Path("/proc").glob("[0-9]*/fd/*"):
        # Of another user, or gone meanwhile.
        with suppress(OSError):
            if str(link.readlink()) in sockets:
                process = link.parents[1]
                command = (process / "cmdline").read_text(errors="replace").replace("\0", " ").strip()
                shown = "".join(c if c.isprintable() else "?" for c in command[:120])
                return f" by process {process.name}" + (f" ({shown})" if shown else "")
    return " by a process of another user"


def serve_page(
    source: Source,
    port: int,
    address: str,
    on_start: Callable[[str], None],
    until: Callable[[], bool] = lambda: False,
) -> None:
    """Serve the page until interrupted.

    Args:
        source: of the data; closed at the end.
        port: see :class:`ViewServer`.
        address: see there.
        on_start: called with the address of the page.
        until: ends the server when it is true.

    Raises:
        ViewError: see :class:`ViewServer`.
    """

    async def work() -> None:
        server = ViewServer(source, port, address)
        try:
            on_start(server.url)
            while not until():
                await asyncio.sleep(0.1)
                if server.failure is not None:
                    raise server.failure
        finally:
            server.close()

    try:
        asyncio.run(work())
    finally:
        source.close()


def announce(say: Callable[[str], None], url: str, open_page: bool | None = None) -> None:
    """Say the address of the page, and open it.

    Args:
        say: prints a line.
        url: address.
        open_page: whether to open it; None where there is a display.
    """
    say(f"Page at {url} (Ctrl-C ends it)")
    display = bool(os.environ.get("DISPLAY") or os.environ.get("WAYLAND_DISPLAY"))
    if display if open_page is None else open_page:
        webbrowser.open(url)
