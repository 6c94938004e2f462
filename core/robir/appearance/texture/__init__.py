# SPDX-License-Identifier: Apache-2.0
"""Albedo, roughness and normals of every texel, read under the solved light."""
