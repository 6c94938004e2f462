# SPDX-License-Identifier: Apache-2.0
"""Poses as phones and other programs write them, one format a file."""
