# SPDX-FileCopyrightText: 2026 The quadpi authors
# SPDX-License-Identifier: Apache-2.0
"""Databases of rosbag2 that are damaged, or hold other values than a recorder writes."""

import sqlite3
from contextlib import closing

import pytest
from rosbags.rosbag2 import CompressionMode, StoragePlugin

from quadpi_core.errors import LogError
from quadpi_core.logs.bag_files import Bag

from .bag_examples import write_folder


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ("UPDATE topics SET type = x'00' WHERE id = 1", "damaged: topic /[a-z/]+ is of type b"),
        ("UPDATE messages SET data = 7 WHERE id = 5", "damaged: a message of topic /[a-z/]+ is none"),
        ("UPDATE messages SET timestamp = 'x' WHERE id = 5", "damaged: a message of topic /[a-z/]+ is none"),
        ("DROP TABLE messages", "cannot be read: no such table: messages"),
        (
            "ALTER TABLE topics RENAME TO t; CREATE VIEW topics AS SELECT * FROM t",
            ".* computes what it holds",
        ),
    ],
)
def test_values_that_are_none(tmp_path, sensor_topics, change, message):
    write_folder(tmp_path / "flight", sensor_topics, StoragePlugin.SQLITE3, CompressionMode.NONE)
    path = tmp_path / "flight" / "flight.db3"
    with closing(sqlite3.connect(path)) as database:
        database.executescript(change)
        database.commit()
    with pytest.raises(LogError, match=rf"flight.db3: {message}"), Bag(path) as bag:
        bag.read([topic.name for topic in sensor_topics])


def test_what_the_writer_noted_of_a_database_by_itself(tmp_path, sensor_topics):
    write_folder(tmp_path / "flight", sensor_topics, StoragePlugin.SQLITE3, CompressionMode.NONE)
    path = tmp_path / "flight" / "flight.db3"
    note = "version: 9\ncustom_data:\n  vehicle: bebop2\n"
    with closing(sqlite3.connect(path)) as database:
        database.execute("UPDATE metadata SET metadata = ?", [note])
        database.commit()
    with Bag(path) as bag:
        assert bag.metadata == {"vehicle": "bebop2"}
