# SPDX-License-Identifier: Apache-2.0
"""OpenCV without its type stubs, which forget the element type of every array."""

from __future__ import annotations

from typing import Any

import cv2 as _library

cv2: Any = _library  # the library; its functions give arrays of the type they were given
