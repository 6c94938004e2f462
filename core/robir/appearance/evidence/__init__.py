# SPDX-License-Identifier: Apache-2.0
"""Priors on the brightness and hue of the light as a whole."""
