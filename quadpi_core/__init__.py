# SPDX-FileCopyrightText: 2026 The quadpi authors
# SPDX-License-Identifier: Apache-2.0
"""Aerodynamic models of quadrotors with prediction intervals, and the monitor that watches them."""

__version__ = "0.1.0"
