# SPDX-License-Identifier: Apache-2.0
"""Roughness, metal and the specular light that comes with them."""
