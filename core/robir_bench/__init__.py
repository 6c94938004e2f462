# SPDX-License-Identifier: Apache-2.0
"""Many runs on captures with truth, and one table of their scores."""
