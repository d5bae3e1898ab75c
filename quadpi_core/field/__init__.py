# SPDX-FileCopyrightText: 2026 The quadpi authors
# SPDX-License-Identifier: Apache-2.0
"""What the log of any multirotor tells, without tachometer, motion capture or mass: `quadpi report`."""
