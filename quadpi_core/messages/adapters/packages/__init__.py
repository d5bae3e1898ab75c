# SPDX-FileCopyrightText: 2026 The quadpi authors
# SPDX-License-Identifier: Apache-2.0
"""Messages that are understood, one file per package or family; `adapter_registry` finds them."""
