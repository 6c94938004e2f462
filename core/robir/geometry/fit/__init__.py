# SPDX-License-Identifier: Apache-2.0
"""The surface by a fit: a distance field whose renderings repeat the photographs (NeuS)."""
