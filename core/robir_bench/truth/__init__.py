# SPDX-License-Identifier: Apache-2.0
"""Scores of a result against known truth; every score with its definition."""
