# SPDX-FileCopyrightText: 2026 The quadpi authors
# SPDX-License-Identifier: Apache-2.0
"""ROS 2 nodes around quadpi_core: parameters, serialized messages in, the core, serialized messages out."""
