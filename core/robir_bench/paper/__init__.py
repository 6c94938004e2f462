# SPDX-License-Identifier: Apache-2.0
"""RobIR as published, and InvRender before it: the baselines of every chart."""
