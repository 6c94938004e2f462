# SPDX-License-Identifier: GPL-3.0-or-later
"""The light of a result, other lights, and pictures under them through the recovered tone curve."""
