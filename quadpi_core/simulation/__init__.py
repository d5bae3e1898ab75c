# SPDX-FileCopyrightText: 2026 The quadpi authors
# SPDX-License-Identifier: Apache-2.0
"""Simulated flights: rotor-local aerodynamics, rigid body, controller, scenarios, effects, sensors."""
