# SPDX-License-Identifier: GPL-3.0-or-later
"""Photographs as a hand-held camera takes them, of one thing on a table, with truth.

`recipe` says what was drawn, `things`, `finishes` and `surroundings` build it, `render` renders,
`response`, `developing`, `matting` and `posing` make of it what a user brings, `writing` writes.
"""
