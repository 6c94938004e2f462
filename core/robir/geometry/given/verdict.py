# SPDX-License-Identifier: Apache-2.0
"""What the agreement of a mesh's outlines with the masks means."""

from __future__ import annotations

from robir.geometry.given.placing import FITS, Agreement

_UNRELATED = 0.5  # below which a mesh shows something else
# share of the masks that a mesh within them may lack, or of it that may lie beyond them all
_MOST_APART = 0.8


def is_related(agreement: Agreement) -> bool:
    """Whether a mesh shows the object, or a part of it, or it and more, at the right place."""
    wrong = sorted((agreement.missing, agreement.beyond))
    is_part = wrong[0] <= 1 - FITS and wrong[1] < _MOST_APART
    return agreement.share >= _UNRELATED or is_part


def poor_fit(agreement: Agreement, fits: float) -> tuple[str, ...]:
    """What is to be said of a mesh that stands right and yet is not what the masks show.

    Args:
        agreement: Of its outlines with the masks.
        fits: Share from which it is.
    """
    if agreement.share >= fits:
        return ()
    parts = []
    if agreement.missing > 1 - fits:
        parts.append(
            f"it lacks {agreement.missing:.0%} of what the masks show, of which nothing is made"
        )
    if agreement.beyond > 1 - fits:
        parts.append(
            f"{agreement.beyond:.0%} of its outline lies beyond the masks; that part only shades"
        )
    return (f"The mesh fits the masks by {agreement.share:.0%} only: {' and '.join(parts)}.",)
