# SPDX-FileCopyrightText: 2026 The quadpi authors
# SPDX-License-Identifier: Apache-2.0
"""Readers that trust a file, in a process of their own with limits: whatever it does to them is one error.

A damaged file makes libraries crash, loop, or take the memory that a few bytes announce. The process is a
fork, which takes some 10 ms, and works on a single thread; it ends with the reading.
"""

from __future__ import annotations

import faulthandler
import gc
import os
import pickle
import resource
import signal
import time
import warnings
from collections.abc import Callable, Generator, Iterable, Iterator
from contextlib import suppress
from multiprocessing import Pipe
from multiprocessing.connection import Connection
from pathlib import Path
from typing import Any, ParamSpec, TypeVar

from quadpi_core.errors import LogError, QuadpiError, one_line
from quadpi_core.paths import LIMIT_DEFAULT_MIB, LIMIT_VARIABLE

# A file may unpack to this many times its size, if that is more: repeated values compress to a fiftieth.
LIMIT_RATIO = 100
# Memory of a reader, in multiples of what its file may unpack to: what is unpacked, and a copy that is sent.
_MEMORY_FACTOR = 2
# Processor time of a reader [s], and bytes of a file that give it a second more: pyulog reads 5 MB in one,
# rosbags 1 MB. A reader that waits, for a lock that nobody opens, may take so many times as long.
_SECONDS, _BYTES_PER_SECOND, _PATIENCE = 4, 100_000, 20

# Its first number is the address space of this process, in pages. Only Linux has it, and holds a limit of it.
_SIZES = Path("/proc/self/statm")

_Parameters = ParamSpec("_Parameters")
_Part = TypeVar("_Part")


def unpacked_limit(packed_bytes: int) -> int:
    """Largest number of bytes that a file of `packed_bytes` may unpack to.

    Raises:
        QuadpiError: if $QUADPI_UNPACKED_MIB is not a positive whole number.
    """
    text = os.environ.get(LIMIT_VARIABLE, str(LIMIT_DEFAULT_MIB))
    if not (text.isascii() and text.isdecimal() and len(text) < 10 and int(text) > 0):
        raise QuadpiError(f"{LIMIT_VARIABLE} must be a positive whole number of MiB, found {text!r}")
    return max(int(text) * 2**20, LIMIT_RATIO * packed_bytes)


def require_unpackable(packed_bytes: int, unpacked_bytes: int) -> None:
    """Refuse a file of `packed_bytes` that unpacks to more than :func:`unpacked_limit`, saying how much."""
    if unpacked_bytes > unpacked_limit(packed_bytes):
        raise _too_much(packed_bytes)


def _too_much(packed_bytes: int) -> LogError:
    return LogError(
        f"unpacks to more than the limit of {unpacked_limit(packed_bytes) // 2**20} MiB, or is damaged; "
        f"{LIMIT_VARIABLE} or `quadpi --unpacked-mib` raises the limit for files that can be trusted"
    )


def read_apart(
    file_bytes: int,
    read: Callable[_Parameters, Iterable[_Part]],
    *args: _Parameters.args,
    **options: _Parameters.kwargs,
) -> Generator[_Part, None, None]:
    """What a reader yields, run in a process of its own.

    Args:
        file_bytes: size of what it reads, by which its memory, its time and what it yields are limited.
        read: makes parts that can be pickled. It is called in the other process, and leaves nothing in this.
        args: of `read`.
        options: of `read`.

    Raises:
        LogError: for every error of the reader; those that are not quadpi's own begin with "cannot be read".
    """
    receiver, sender = Pipe(duplex=False)
    with warnings.catch_warnings():
        # Of other threads: the reader waits for none, and for no lock of theirs longer than its time.
        warnings.simplefilter("ignore", DeprecationWarning)
        process = os.fork()
    if process == 0:
        try:
            # Else what it sends would wait for ever where the process that asked has been killed.
            receiver.close()
            sender.send((False, _sent(sender, file_bytes, lambda: read(*args, **options))))
        finally:
            # Whatever happens, a signal for example: the rest of this program is not for this process to run.
            os._exit(0)
    sender.close()
    try:
        yield from _received(receiver, process, file_bytes)
    finally:
        receiver.close()
        with suppress(ProcessLookupError, ChildProcessError):
            os.kill(process, signal.SIGKILL)
            os.waitpid(process, 0)


def _seconds(file_bytes: int) -> int:
    return _SECONDS + file_bytes // _BYTES_PER_SECOND


def _sent(
    sender: Connection, file_bytes: int, read: Callable[[], Iterable[object]]
) -> LogError | MemoryError | None:
    """In the other process: send (True, part) for each part; gives the error that ended it, or None."""
    try:
        faulthandler.disable()
        # It would copy all memory that is shared, to find what ends with this process anyway.
        gc.disable()
        # What libraries print, and C++ as it crashes.
        silence = os.open(os.devnull, os.O_WRONLY)
        os.dup2(silence, 1)
        os.dup2(silence, 2)
        limits = {resource.RLIMIT_CPU: _seconds(file_bytes), resource.RLIMIT_CORE: 0}
        if _SIZES.exists():
            held = int(_SIZES.read_text().split()[0]) * resource.getpagesize()
            limits[resource.RLIMIT_AS] = held + _MEMORY_FACTOR * unpacked_limit(file_bytes)
        for kind, limit in limits.items():
            _, most = resource.getrlimit(kind)
            resource.setrlimit(kind, (limit if most < 0 else min(limit, most), most))
        for part in read():
            sender.send((True, part))
    except (LogError, MemoryError) as error:
        return error
    except QuadpiError as error:
        return LogError(str(error))
    except OSError as error:
        return LogError(f"cannot be read: {error.strerror or one_line(error)}")
    except Exception as error:  # libraries raise many kinds on damaged bytes
        return LogError(f"cannot be read: {one_line(error) or type(error).__name__}")
    return None


def _received(receiver: Connection, process: int, file_bytes: int) -> Iterator[Any]:
    left_bytes = unpacked_limit(file_bytes)
    left_s = float(_PATIENCE * _seconds(file_bytes))
    while True:
        began = time.monotonic()
        if not receiver.poll(max(left_s, 0.0)):
            raise LogError("cannot be read: its reader does not end")
        try:
            content = receiver.recv_bytes()
        except (EOFError, OSError):
            ended = os.waitid(os.P_PID, process, os.WEXITED | os.WNOWAIT)
            reason = signal.Signals(ended.si_status).name if ended and ended.si_status else "it ended"
            said = "does not end" if reason == "SIGXCPU" else f"crashed ({reason})"
            raise LogError(f"cannot be read: damaged, its reader {said}") from None
        left_s -= time.monotonic() - began
        left_bytes -= len(content)
        if left_bytes < 0:
            raise _too_much(file_bytes)
        is_part, part = pickle.loads(content)
        if is_part:
            yield part
        elif isinstance(part, MemoryError):
            raise _too_much(file_bytes)
        elif part is not None:
            raise part
        else:
            return
