# SPDX-FileCopyrightText: 2026 The quadpi authors
# SPDX-License-Identifier: Apache-2.0
"""`quadpi view`: what it refuses, and that it serves a bag until Ctrl-C."""

from __future__ import annotations

import signal
import socket
import subprocess
import sys
import urllib.request
from pathlib import Path

import pytest

from quadpi_core.paths import bags_directory

MODEL = Path(__file__).resolve().parents[2] / "golden" / "model"
BAG = bags_directory() / "extrapolation.mcap"
QUADPI = Path(sys.executable).with_name("quadpi")


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        ([BAG, "--vehicle", "bebop2"], "--vehicle: is that of the models, and there is no --model"),
        (["--confidence", "0.9"], "--confidence: is for a bag that --model judges"),
        (["missing.mcap", "--model", MODEL, "--port", "0"], "missing.mcap: "),
        ([BAG, "--model", "missing"], "missing/model.json: "),
    ],
)
def test_a_refusal_is_one_line(quadpi, arguments, message):
    said = quadpi("view", *arguments, "--no-open")
    assert said.status == 2
    assert message in said.errors
    assert len(said.errors.strip().splitlines()) == 1


def test_a_port_in_use_is_refused_and_none_is_taken_instead(quadpi):
    with socket.socket() as other:
        other.bind(("127.0.0.1", 0))
        other.listen()
        port = other.getsockname()[1]
        said = quadpi("view", BAG, "--model", MODEL, "--port", port, "--no-open")
    assert said.status == 2
    assert f"port {port} is in use by process" in said.errors


def test_a_bag_is_served_until_it_is_interrupted():
    command = [QUADPI, "view", BAG, "--model", MODEL, "--port", "0", "--no-open"]
    with subprocess.Popen(command, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True) as process:
        try:
            url = next(word for line in process.stdout for word in line.split() if word.startswith("http://"))
            with urllib.request.urlopen(url) as page:
                assert b"<title>" in page.read()
        finally:
            process.send_signal(signal.SIGINT)
        assert (process.wait(), process.stderr.read()) == (0, "")
