# SPDX-FileCopyrightText: 2026 The quadpi authors
# SPDX-License-Identifier: Apache-2.0
"""The kinds of model, one file each; see :mod:`quadpi_core.models.kind_registry`."""
