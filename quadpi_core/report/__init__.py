# SPDX-FileCopyrightText: 2026 The quadpi authors
# SPDX-License-Identifier: Apache-2.0
"""Results to look at: tables for the terminal, figures, and a self-contained page."""
