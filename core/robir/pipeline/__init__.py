# SPDX-License-Identifier: Apache-2.0
"""Runs the stages in order, remembers what is done, and resumes."""
