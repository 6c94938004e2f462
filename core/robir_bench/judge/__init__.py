# SPDX-License-Identifier: Apache-2.0
"""Judging a state of the program: what each error costs, and scores that outlive their captures."""
