# SPDX-License-Identifier: Apache-2.0
"""What highlights tell of the light: its level, its hue, and the sky that metal mirrors."""
