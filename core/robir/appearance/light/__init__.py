# SPDX-License-Identifier: Apache-2.0
"""Sky and suns: found, solved, and given level and hue."""
