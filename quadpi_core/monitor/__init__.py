# SPDX-FileCopyrightText: 2026 The quadpi authors
# SPDX-License-Identifier: Apache-2.0
"""The monitor: predictions with intervals and the alarm, sample by sample, live and in replay."""

from quadpi_core.models.envelope import Envelope
from quadpi_core.monitor.alarm import MonitorSettings
from quadpi_core.monitor.monitor import Monitor
from quadpi_core.results import Alarms, Predictions

__all__ = ["Alarms", "Envelope", "Monitor", "MonitorSettings", "Predictions"]
