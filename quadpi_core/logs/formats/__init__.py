# SPDX-FileCopyrightText: 2026 The quadpi authors
# SPDX-License-Identifier: Apache-2.0
"""Log formats, one file each; :mod:`quadpi_core.logs.readers` finds them."""
