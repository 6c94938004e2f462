# SPDX-License-Identifier: Apache-2.0
"""Masks for photographs that have poses but no masks."""
