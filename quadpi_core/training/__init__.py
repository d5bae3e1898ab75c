# SPDX-FileCopyrightText: 2026 The quadpi authors
# SPDX-License-Identifier: Apache-2.0
"""Training of many small networks as one batch; the only room that needs PyTorch."""
