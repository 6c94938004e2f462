# SPDX-License-Identifier: Apache-2.0
"""Many captures into one library of results, on this machine, on Slurm or on a render farm."""
