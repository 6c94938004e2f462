# SPDX-License-Identifier: Apache-2.0
"""The report: one self-contained page, the asset to turn first, and its numbers as JSON."""
