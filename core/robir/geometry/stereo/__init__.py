# SPDX-License-Identifier: Apache-2.0
"""Depth by stereo: where photographs agree, before any surface is fitted to them."""
