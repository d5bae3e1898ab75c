# SPDX-FileCopyrightText: 2026 The quadpi authors
# SPDX-License-Identifier: Apache-2.0
"""Child processes that end with a `with` block, and a reserved ROS domain for them."""

from __future__ import annotations

import os
import random
import socket
import subprocess
import sys
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from pathlib import Path

from quadpi_core.errors import QuadpiError
from quadpi_core.paths import scratch_folder

_STOP_TIMEOUT_S = 5.0
# The domains that ROS's `domain_coordinator` gives to tests, and the port that reserves the domain before the
# first: who holds port _DOMAIN_PORT + n owns domain n. The DDS ports of domains above 101 are ephemeral ones.
_DOMAINS = range(1, 101)
_DOMAIN_PORT = 32768


class ChildError(QuadpiError):
    """A child process failed."""


class Child:
    """A Python module run as a child process; a context manager that ends it.

    Args:
        module: run as `python -m`.
        arguments: of its command line.
        folder: for a file with its stderr.

    Attributes:
        errors: that file.
        pid: of the process.
    """

    def __init__(self, module: str, arguments: Sequence[str], folder: Path) -> None:
        self._name = module.rpartition(".")[2]
        self.errors = folder / f"{module}.err"
        with self.errors.open("wb") as errors:
            self._process = subprocess.Popen(
                [sys.executable, "-m", module, *arguments], stdout=subprocess.DEVNULL, stderr=errors
            )
        self.pid = self._process.pid

    def __enter__(self) -> Child:
        return self

    def __exit__(self, *_: object) -> None:
        self._process.terminate()
        try:
            self._process.wait(_STOP_TIMEOUT_S)
        except subprocess.TimeoutExpired:
            self._process.kill()
            self._process.wait()

    def finished(self) -> bool:
        """Whether it has ended with status 0.

        Raises:
            ChildError: if it has failed, with the last line of its stderr.
        """
        status = self._process.poll()
        if status:
            lines = self.errors.read_text(errors="replace").splitlines() or [f"exit status {status}"]
            raise ChildError(f"{self._name}: {lines[-1].removeprefix('quadpi: ')}")
        return status is not None


@contextmanager
def isolated_domain() -> Iterator[Path]:
    """Reserve a ROS domain for this process and its children; gives a scratch folder."""
    before = dict(os.environ)
    with scratch_folder() as folder, _reserved_domain() as domain:
        os.environ |= {
            "ROS_AUTOMATIC_DISCOVERY_RANGE": "LOCALHOST",
            "ROS_DOMAIN_ID": str(domain),
            "ROS_LOG_DIR": str(folder),
            # For one sample at a time, threads of the linear algebra cost more than they save.
            "OMP_NUM_THREADS": "1",
        }
        try:
            yield folder
        finally:
            os.environ.clear()
            os.environ.update(before)


@contextmanager
def _reserved_domain() -> Iterator[int]:
    """A ROS domain that no other process on this machine has reserved in the same way.

    Raises:
        ChildError: if none is free.
    """
    for domain in random.sample(_DOMAINS, len(_DOMAINS)):
        with socket.socket() as reservation:
            try:
                reservation.bind(("", _DOMAIN_PORT + domain))
            except OSError:
                continue
            yield domain
            return
    raise ChildError("every ROS domain of this machine is taken")
