# SPDX-FileCopyrightText: 2026 The quadpi authors
# SPDX-License-Identifier: Apache-2.0
"""Signals on one grid through one low-pass: filters, resampling, and the measured wrench."""
