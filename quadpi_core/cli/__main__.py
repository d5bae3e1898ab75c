# SPDX-FileCopyrightText: 2026 The quadpi authors
# SPDX-License-Identifier: Apache-2.0
"""`python -m quadpi_core.cli`."""

from quadpi_core.cli import main

if __name__ == "__main__":
    main()
