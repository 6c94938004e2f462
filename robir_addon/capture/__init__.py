# SPDX-License-Identifier: GPL-3.0-or-later
"""A capture in the open file, before anything is computed: cameras, photographs, bounds."""
