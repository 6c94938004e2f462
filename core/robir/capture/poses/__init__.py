# SPDX-License-Identifier: Apache-2.0
"""Cameras for photographs that have none: structure from motion with pycolmap, which is optional.

Photographs or a video in, a COLMAP model out that the capture room reads like any other. Steps:
upright grey copies (`register`), SIFT features and matches and incremental mapping (`sfm`), and
what the outcome means to someone with a camera in the hand (`diagnose`).
"""
