# SPDX-FileCopyrightText: 2026 The quadpi authors
# SPDX-License-Identifier: Apache-2.0
"""The EKF that fuses IMU and motion capture, live and over whole flights, and the smoother."""
