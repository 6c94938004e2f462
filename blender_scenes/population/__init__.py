# SPDX-License-Identifier: GPL-3.0-or-later
"""Random captures with truth: `ranges` says from what, `draw` draws, `command` renders."""
