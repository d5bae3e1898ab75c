# SPDX-FileCopyrightText: 2026 The quadpi authors
# SPDX-License-Identifier: Apache-2.0
"""Messages of .db3 files, the databases of rosbag2, as :mod:`quadpi_core.logs.bag_files` reads them."""

from __future__ import annotations

import sqlite3
from collections.abc import Collection, Iterator
from itertools import islice
from pathlib import Path
from typing import Any
from urllib.parse import quote

import yaml

from quadpi_core.errors import LogError, one_line
from quadpi_core.logs.mcap_files import Batch, Connection

_BATCH = 1000


class DatabaseFile:
    """An open .db3 file; its attributes are those of :class:`.McapFile`.

    Raises:
        LogError: if it is damaged, or has a view in the place of a table: that may have no end.
    """

    def __init__(self, path: Path) -> None:
        self._database = sqlite3.connect(f"file:{quote(str(path.absolute()))}?mode=ro&immutable=1", uri=True)
        made = dict(self._rows("SELECT lower(name), type FROM sqlite_master"))
        for name, kind in made.items():
            if kind == "view":
                raise LogError(f"damaged: its table `{name}` computes what it holds")
        definitions: dict[str, str] = {}
        if "message_definitions" in made:
            columns = "topic_type, encoded_message_definition"
            definitions = dict(
                self._rows(f"SELECT {columns} FROM message_definitions WHERE encoding = 'ros2msg'")
            )
        counts = dict(self._rows("SELECT topic_id, COUNT(*) FROM messages GROUP BY topic_id"))
        self.connections: dict[int, Connection] = {}
        for number, topic, type_name in self._rows("SELECT id, name, type FROM topics"):
            if not isinstance(topic, str) or not isinstance(type_name, str):
                raise LogError(f"damaged: topic {topic} is of type {type_name}")
            if number in self.connections:
                raise LogError("damaged: topics of the same number")
            connection = Connection(topic, type_name, definitions.get(type_name, ""), counts.get(number, 0))
            self.connections[number] = connection
        self.custom: dict[str, str] | None = None
        for (text,) in self._rows("SELECT metadata FROM metadata") if "metadata" in made else ():
            self.custom = (yaml.safe_load(text) or {}).get("custom_data")

    def _rows(self, query: str) -> Iterator[Any]:
        try:
            yield from self._database.execute(query)
        except sqlite3.Error as error:
            reason = one_line(error)
            if "malformed" in reason:
                reason += "; `sqlite3 FILE .recover | sqlite3 whole.db3` rebuilds what is whole of it"
            raise LogError(f"cannot be read: {reason}") from error

    def batches(self, wanted: Collection[int], _head: int | None) -> Iterator[Batch]:
        """The messages of some topics, in the order of their log times."""
        numbers = ", ".join(str(int(number)) for number in wanted)
        rows = self._rows(
            f"SELECT topic_id, timestamp, data FROM messages WHERE topic_id IN ({numbers}) ORDER BY timestamp"
        )
        while part := list(islice(rows, _BATCH)):
            messages: dict[int, tuple[list[int], list[bytes]]] = {number: ([], []) for number in wanted}
            for number, time_ns, data in part:
                if not isinstance(time_ns, int) or not isinstance(data, bytes):
                    raise LogError(f"damaged: a message of topic {self.connections[number].topic} is none")
                messages[number][0].append(time_ns)
                messages[number][1].append(data)
            yield Batch.listed(part[0][1], messages)
