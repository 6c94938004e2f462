# SPDX-License-Identifier: Apache-2.0
"""Formulas: tensors in, tensors out; no files, no parameters, no device choice."""
