# SPDX-FileCopyrightText: 2026 The quadpi authors
# SPDX-License-Identifier: Apache-2.0
"""The monitor: predictions with intervals and the alarm, sample by sample, live and in replay."""
