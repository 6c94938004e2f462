# SPDX-License-Identifier: Apache-2.0
"""The ground an object stands on, told from what stands on it and made flat."""
