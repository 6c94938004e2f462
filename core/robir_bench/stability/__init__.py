# SPDX-License-Identifier: Apache-2.0
"""Captures spoilt one factor at a time, and what that costs."""
