# SPDX-FileCopyrightText: 2026 The quadpi authors
# SPDX-License-Identifier: Apache-2.0
"""`quadpi view`: what it refuses, and that it serves a bag until Ctrl-C."""

from __future__ import annotations

import signal
import socket
import subprocess
import sys
import urllib.request
from collections.abc import Iterator
from pathlib import Path

import pytest

from quadpi_core.paths import bags_directory

MODEL = Path(__file__).resolve().parents[2] / "golden" / "model"
BAG = bags_directory() / "extrapolation.mcap"
QUADPI = Path(sys.executable).with_name("quadpi")


@pytest.fixture
def taken() -> Iterator[int]:
    """A port that somebody listens on."""
    with socket.socket() as one:
        one.bind(("127.0.0.1", 0))
        one.listen()
        yield one.getsockname()[1]


@pytest.mark.parametrize(
    ("arguments", "said"),
    [
        ((BAG,), f"{BAG}: holds no predictions; judge it by a model: quadpi view {BAG} --model MODEL"),
        (("nothing.mcap", "--model", MODEL), "nothing.mcap: no such"),
        ((BAG, "--model", "nothing"), "nothing"),
        ((BAG, "--vehicle", "bebop2"), "--vehicle: is that of the models, and there is no --model"),
        ((BAG, "--model", MODEL, "--vehicle", "neurobem"), "is of vehicle bebop2, not neurobem"),
        ((BAG, "--model", MODEL, "--model", MODEL), "--model: two models have the same name"),
        (("--at", "3"), "--at: is a moment of a bag, and none is given"),
        ((BAG, "--model", MODEL, "--at", "inf"), "--at inf: is no moment"),
        (("--confidence", "0.9"), "--confidence: is for a bag that --model judges"),
    ],
)
def test_what_cannot_be_shown_is_one_line(quadpi, arguments, said):
    outcome = quadpi("view", *arguments, "--port", 0, "--no-open")
    assert outcome.status == 2
    assert said in outcome.errors
    assert outcome.errors.count("\n") == 1


def test_a_port_in_use_is_refused_and_none_chosen_instead(quadpi, taken):
    outcome = quadpi("view", BAG, "--model", MODEL, "--port", taken, "--no-open")
    assert outcome.status == 2
    assert f"port {taken} is in use by process" in outcome.errors
    assert "Page at" not in outcome.output


@pytest.mark.parametrize("port", ["65536", "-1", "http"])
def test_a_port_that_is_none_is_refused(quadpi, port):
    assert quadpi("view", BAG, "--model", MODEL, "--port", port).status == 2


def test_a_bag_is_served_until_it_is_interrupted():
    command = [QUADPI, "view", BAG, "--model", MODEL, "--at", "12.3", "--port", "0", "--no-open"]
    with subprocess.Popen(command, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True) as process:
        try:
            url = next(word for line in process.stdout for word in line.split() if word.startswith("http://"))
            assert url.endswith("/#t=12.3")
            with urllib.request.urlopen(url) as page:
                assert b"<title>" in page.read()
            process.send_signal(signal.SIGINT)
            _, errors = process.communicate(timeout=60.0)
        finally:
            process.kill()
    assert (process.returncode, errors) == (0, "")
