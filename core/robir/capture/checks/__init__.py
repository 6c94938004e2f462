# SPDX-License-Identifier: Apache-2.0
"""What is wrong with a capture, in sentences, before time is spent on it."""
