# SPDX-License-Identifier: GPL-3.0-or-later
"""The finished sample that comes with the add-on."""
