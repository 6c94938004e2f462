# SPDX-License-Identifier: Apache-2.0
"""How well a result repeats photographs, and which level of the chain loses them."""
