# SPDX-License-Identifier: Apache-2.0
"""Settings of the transport stage."""

from __future__ import annotations

from dataclasses import dataclass

from robir.errors import ConfigError


@dataclass(frozen=True, slots=True, kw_only=True)
class TransportConfig:
    """How finely surface, directions and photographs are sampled.

    Attributes:
        num_surfels: Surface samples, spread evenly over what the cameras see.
        num_directions: Directions of the full sphere in which visibility is traced.
        observation_side: Longest side of the photographs that surfels are read from, pixels; a
            surfel is about as large as such a pixel.
        max_views: Views that are read, spread evenly over the capture.
        use_visibility: Whether surfaces block light; off only for ablation.
        use_indirect: Whether light that bounced once is counted; off only for ablation.
    """

    num_surfels: int = 16000
    num_directions: int = 512
    observation_side: int = 200
    max_views: int = 48
    use_visibility: bool = True
    use_indirect: bool = True

    def __post_init__(self) -> None:
        """Refuse sizes that cannot work."""
        for name, low in (
            ("num_surfels", 500),
            ("num_directions", 64),
            ("observation_side", 16),
            ("max_views", 3),
        ):
            if getattr(self, name) < low:
                raise ConfigError(
                    f"transport.{name} is {getattr(self, name)}; it must be at least {low}"
                )
