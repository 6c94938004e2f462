# SPDX-License-Identifier: Apache-2.0
"""Readers: files of one format in, photographs that are named and posed out."""
