# SPDX-License-Identifier: Apache-2.0
"""Tone curve, light, albedo and roughness from photographs and baked transport."""
