# SPDX-License-Identifier: Apache-2.0
"""Which tone curve the photographs went through."""
