# SPDX-License-Identifier: Apache-2.0
"""From a photograph's file to a view: opened safely, decoded, cut, undistorted, reduced."""
