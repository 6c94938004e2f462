# SPDX-License-Identifier: Apache-2.0
"""Radiance of surface samples, and how each photograph was exposed and lit."""
