# SPDX-License-Identifier: Apache-2.0
"""Cameras for photographs that have none: structure from motion with pycolmap, if installed."""
