# SPDX-License-Identifier: Apache-2.0
"""The result folder as a contract: paths, status and events, with the standard library only."""
