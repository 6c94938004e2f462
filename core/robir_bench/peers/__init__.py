# SPDX-License-Identifier: Apache-2.0
"""Other methods beside ours: photographs as texture, and Mitsuba's path replay."""
