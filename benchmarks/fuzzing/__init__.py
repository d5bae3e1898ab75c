# SPDX-FileCopyrightText: 2026 The quadpi authors
# SPDX-License-Identifier: Apache-2.0
"""Fuzzing of every reader with randomly damaged small files; a case is a format, a seed and a number."""
