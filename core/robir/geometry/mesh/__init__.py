# SPDX-License-Identifier: Apache-2.0
"""Triangles: extracted from a field, cleaned, decimated, unwrapped, and met by rays."""
