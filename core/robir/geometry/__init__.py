# SPDX-License-Identifier: Apache-2.0
"""From masked photographs to a clean, unwrapped triangle mesh."""
