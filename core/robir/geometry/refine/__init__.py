# SPDX-License-Identifier: Apache-2.0
"""The mesh moved to where photographs agree, along its normals."""
