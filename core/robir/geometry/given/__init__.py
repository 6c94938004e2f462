# SPDX-License-Identifier: Apache-2.0
"""A mesh that the user hands in: read, checked, placed among the photographs, made ready."""
