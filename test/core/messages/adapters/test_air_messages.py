# SPDX-FileCopyrightText: 2026 The quadpi authors
# SPDX-License-Identifier: Apache-2.0
"""Pressure and temperature, each of which knows nothing of the other; PX4's message knows both."""

from __future__ import annotations

import numpy as np
import pytest

from quadpi_core.inputs import Air, density_of
from quadpi_core.messages.adapters import known_adapters

from .test_adapter_registry import opened
from .vendor_messages import EXAMPLES, START_NS, of_the_air


def test_both_together_tell_the_density(vendor) -> None:
    pressure, temperature = (
        opened(vendor.px4_1_14, name).unpack(EXAMPLES[name](vendor.px4_1_14))
        for name in ("fluid_pressure", "temperature")
    )
    assert (pressure.pressure[0], temperature.celsius[0]) == (95000.0, 20.0)
    assert np.isnan((pressure.celsius[0], temperature.pressure[0])).all()
    air = Air()
    assert not air.hear(pressure.pressure[0], pressure.celsius[0])
    assert air.hear(temperature.pressure[0], temperature.celsius[0])
    assert air.density == pytest.approx(float(density_of(np.array(95000.0), np.array(20.0))))


def test_px4_tells_the_temperature_by_its_density(vendor) -> None:
    air = opened(vendor.px4_1_14, "px4_air").unpack(EXAMPLES["px4_air"](vendor.px4_1_14))
    assert density_of(air.pressure, air.celsius) == pytest.approx([1.129], rel=1e-6)


@pytest.mark.parametrize(
    ("name", "field", "wrong", "reason"),
    [
        ("fluid_pressure", "fluid_pressure", 950.0, "no pressure of air in Pa"),
        ("temperature", "temperature", 293.15, "no temperature of air in °C"),
    ],
)
def test_another_unit_is_dropped_and_said(vendor, name, field, wrong, reason) -> None:
    reading, type_name = opened(vendor.px4_1_14, name), known_adapters()[name].type_name
    message = of_the_air(vendor.px4_1_14, type_name, START_NS, **{field: wrong})
    assert len(reading.unpack(message)) == 0
    assert reading.dropped == {reason: 1}
