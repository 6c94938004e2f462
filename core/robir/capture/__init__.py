# SPDX-License-Identifier: Apache-2.0
"""What came in: photographs, cameras, masks, and what is wrong with them."""
