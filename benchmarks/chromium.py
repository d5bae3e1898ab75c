# SPDX-FileCopyrightText: 2026 The quadpi authors
# SPDX-License-Identifier: Apache-2.0
"""A headless Chromium of the distribution, driven by its DevTools protocol."""

from __future__ import annotations

import asyncio
import base64
import json
import shutil
import struct
import subprocess
import time
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from pathlib import Path
from typing import Any
from urllib.request import Request, urlopen

from tornado.websocket import WebSocketClientConnection, websocket_connect

from benchmarks import UnavailableError

PROGRAM = next(filter(None, map(shutil.which, ("chromium", "chromium-browser", "google-chrome"))), None)
WINDOW = (1400, 1300)
START_S, ANSWER_S, POLL_S = 60.0, 60.0, 0.05
_FLAGS = (
    *("--headless=new", "--no-sandbox", "--disable-gpu", "--disable-dev-shm-usage", "--no-first-run"),
    *("--disable-background-networking", "--disable-component-update", "--disable-sync", "--mute-audio"),
    "--remote-debugging-port=0",
)


class Tab:
    """One page of a browser.

    Attributes:
        problems: what its console said as an error, and exceptions, in order.
    """

    def __init__(self, address: str) -> None:
        self._loop = asyncio.new_event_loop()
        self._number = 0
        self.problems: list[str] = []
        self._socket: WebSocketClientConnection = self._loop.run_until_complete(
            asyncio.wait_for(self._connected(address), START_S)
        )
        for domain in ("Page", "Runtime", "Log", "Network"):
            self.call(f"{domain}.enable")
        self.resize(*WINDOW)

    @staticmethod
    async def _connected(address: str) -> WebSocketClientConnection:
        return await websocket_connect(address, max_message_size=1 << 28)

    def call(self, method: str, **parameters: Any) -> dict[str, Any]:
        """The answer to a request of the protocol."""
        return self._loop.run_until_complete(asyncio.wait_for(self._call(method, parameters), ANSWER_S))

    async def _call(self, method: str, parameters: dict[str, Any]) -> dict[str, Any]:
        self._number += 1
        await self._socket.write_message(
            json.dumps({"id": self._number, "method": method, "params": parameters})
        )
        while True:
            text = await self._socket.read_message()
            assert text is not None, "the browser has ended"
            message = json.loads(text)
            self._note(message)
            if message.get("id") == self._number:
                assert "error" not in message, message["error"]
                result: dict[str, Any] = message["result"]
                return result

    def _note(self, message: dict[str, Any]) -> None:
        parameters = message.get("params", {})
        if message.get("method") == "Runtime.exceptionThrown":
            self.problems.append(json.dumps(parameters["exceptionDetails"])[:2000])
        if message.get("method") == "Runtime.consoleAPICalled" and parameters["type"] in {"error", "assert"}:
            self.problems.append(json.dumps(parameters["args"])[:2000])
        if message.get("method") == "Log.entryAdded" and parameters["entry"]["level"] == "error":
            self.problems.append(parameters["entry"]["text"] + " " + parameters["entry"].get("url", ""))

    def resize(self, width: int, height: int) -> None:
        """Give the page a window of another size."""
        size = {"width": width, "height": height, "deviceScaleFactor": 1, "mobile": False}
        self.call("Emulation.setDeviceMetricsOverride", **size)

    def open(self, url: str) -> None:
        """Go to a page."""
        self.call("Page.navigate", url=url)
        self.wait(f"location.href === {json.dumps(url)} && document.readyState === 'complete'")

    def value(self, expression: str) -> Any:
        """Of a JavaScript expression, as JSON; promises are awaited."""
        answer = self.call("Runtime.evaluate", expression=expression, returnByValue=True, awaitPromise=True)
        assert "exceptionDetails" not in answer, answer["exceptionDetails"]
        return answer["result"].get("value")

    def wait(self, expression: str, seconds: float = 20.0) -> Any:
        """The first true value of an expression."""
        deadline = time.monotonic() + seconds
        while not (value := self.value(expression)):
            assert time.monotonic() < deadline, f"not in {seconds:g} s: {expression}; {self.problems}"
            time.sleep(POLL_S)
        return value

    def press(self, key: str) -> None:
        """A key, as typed."""
        text = {"text": key} if len(key) == 1 else {}
        self.call("Input.dispatchKeyEvent", type="keyDown", key=key, **text)
        self.call("Input.dispatchKeyEvent", type="keyUp", key=key)

    def picture(self, scale: float = 1.0, quality: int = 80) -> bytes:
        """What the window shows, as WebP."""
        width, height = self.value("[innerWidth, innerHeight]")
        clip = {"x": 0, "y": 0, "width": width, "height": height, "scale": scale}
        answer = self.call("Page.captureScreenshot", format="webp", quality=quality, clip=clip)
        return base64.b64decode(answer["data"])

    def close(self) -> None:
        """Let go of the page."""

        async def closed() -> None:
            self._socket.close()
            await asyncio.sleep(0)

        self._loop.run_until_complete(closed())
        self._loop.close()


def moving_picture(pictures: Sequence[bytes], step_ms: int) -> bytes:
    """WebP pictures of one size as the frames of one that moves (WebP container specification)."""
    frames = [_chunks(picture)[b"VP8 "] for picture in pictures]
    # Width and height are in the header of the first frame, behind its tag and start code.
    width, height = (value & 0x3FFF for value in struct.unpack_from("<HH", frames[0], 6))
    size = (width - 1).to_bytes(3, "little") + (height - 1).to_bytes(3, "little")
    body = _chunk(b"VP8X", b"\x02\0\0\0" + size) + _chunk(b"ANIM", b"\xff\xff\xff\xff\0\0")
    for frame in frames:
        place = b"\0" * 6 + size + step_ms.to_bytes(3, "little") + b"\x02"
        body += _chunk(b"ANMF", place + _chunk(b"VP8 ", frame))
    return _chunk(b"RIFF", b"WEBP" + body)


def _chunk(name: bytes, content: bytes) -> bytes:
    return name + struct.pack("<I", len(content)) + content + b"\0" * (len(content) % 2)


def _chunks(picture: bytes) -> dict[bytes, bytes]:
    """Contents by name; the header of the file takes twelve bytes."""
    found, place = {}, 12
    while place < len(picture):
        name, length = struct.unpack_from("<4sI", picture, place)
        found[name] = picture[place + 8 : place + 8 + length]
        place += 8 + length + length % 2
    return found


def require_chromium() -> None:
    """Refuse a machine without the browser."""
    if PROGRAM is None:
        raise UnavailableError("no Chromium: apt-get install chromium")


@contextmanager
def chromium(folder: Path) -> Iterator[Tab]:
    """A tab of a browser of its own, whose profile is below the folder."""
    assert PROGRAM is not None
    with (folder / "chromium.err").open("w+") as errors:
        process = subprocess.Popen(
            [PROGRAM, *_FLAGS, f"--user-data-dir={folder / 'profile'}", "about:blank"],
            stdout=subprocess.DEVNULL,
            stderr=errors,
        )
        try:
            tab = Tab(_page_address(folder / "profile" / "DevToolsActivePort"))
            try:
                yield tab
            finally:
                tab.close()
        finally:
            process.terminate()
            process.wait(10)


def _page_address(port_file: Path) -> str:
    deadline = time.monotonic() + START_S
    while not port_file.exists() or not port_file.read_text().strip():
        assert time.monotonic() < deadline, "the browser does not start"
        time.sleep(POLL_S)
    port = port_file.read_text().splitlines()[0]
    with urlopen(Request(f"http://127.0.0.1:{port}/json/new?about:blank", method="PUT")) as answer:
        return str(json.load(answer)["webSocketDebuggerUrl"])
