# SPDX-FileCopyrightText: 2026 The quadpi authors
# SPDX-License-Identifier: Apache-2.0
"""Damaged input for every reader, at random from small files; format, seed and number tell a case."""
