# SPDX-FileCopyrightText: 2026 The quadpi authors
# SPDX-License-Identifier: Apache-2.0
"""From sensor streams to a flight: time alignment, estimation, filtering, measured wrench."""
