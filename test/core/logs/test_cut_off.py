# SPDX-FileCopyrightText: 2026 The quadpi authors
# SPDX-License-Identifier: Apache-2.0
"""A bag that was cut off is read up to the cut, wherever that is."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from quadpi_core.errors import LogError
from quadpi_core.logs.bag_files import Bag
from quadpi_core.logs.mcap_files import is_cut_off, whole_part
from quadpi_core.paths import bags_directory

BAG = bags_directory() / "extrapolation.mcap"


def cut(target: Path, share: float) -> Path:
    content = BAG.read_bytes()
    target.write_bytes(content[: round(share * len(content))])
    return target


@pytest.mark.parametrize("share", [0.3, 0.6, 0.9, 0.999])
def test_it_holds_the_first_messages_of_the_whole_one(tmp_path, share):
    bag = cut(tmp_path / "flight.mcap", share)
    with pytest.raises(LogError, match=r"cut off, it has no footer; \d+ whole messages"):
        Bag(bag)
    with whole_part(bag) as readable, Bag(readable) as part, Bag(BAG) as whole:
        found, full = (one.read(["/imu"])["/imu"] for one in (part, whole))
        count = len(found.payloads)
        assert 0.8 * share * len(full.payloads) - 2000 < count <= len(full.payloads)
        np.testing.assert_array_equal(found.log_time_ns, full.log_time_ns[:count])
        assert found.payloads[count - 1] == full.payloads[count - 1]
    assert not readable.exists()
    assert bag.stat().st_size == round(share * BAG.stat().st_size)


def test_a_whole_bag_is_itself(tmp_path):
    assert not is_cut_off(BAG)
    with whole_part(BAG) as readable:
        assert readable == BAG
    for other in (tmp_path / "absent.mcap", tmp_path):
        assert not is_cut_off(other)


def test_the_folder_of_a_recorder_that_was_killed(tmp_path):
    cut(tmp_path / "flight_0.mcap", 0.6)
    assert is_cut_off(tmp_path)
    with whole_part(tmp_path) as readable, Bag(readable) as bag:
        assert "/imu" in {connection.topic for connection in bag.connections}


def test_errors_name_the_bag_and_the_cut(tmp_path):
    bag = cut(tmp_path / "flight.mcap", 0.6)
    with pytest.raises(LogError) as told, whole_part(bag) as readable:
        raise LogError(f"{readable}: topic imu: damaged")
    assert str(told.value) == f"{bag}: topic imu: damaged (the file is cut off)"


def test_what_is_cut_within_its_first_records_is_refused(tmp_path):
    bag = tmp_path / "flight.mcap"
    bag.write_bytes(BAG.read_bytes()[:20])
    with pytest.raises(LogError, match=r"flight.mcap: .*cut off"), whole_part(bag) as readable:
        Bag(readable)
