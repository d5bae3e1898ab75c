# SPDX-FileCopyrightText: 2026 The quadpi authors
# SPDX-License-Identifier: Apache-2.0
"""Messages as bytes and as arrays: CDR, quadpi's own and the standard types, and those of other packages."""
