# SPDX-FileCopyrightText: 2026 The quadpi authors
# SPDX-License-Identifier: Apache-2.0
"""The live page in a browser: decimated flights, the words of their state, and the server."""
