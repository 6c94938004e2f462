# SPDX-License-Identifier: Apache-2.0
"""How light reaches the surface: exact visibility, one bounce, and what the cameras saw."""
