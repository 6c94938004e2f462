# SPDX-License-Identifier: Apache-2.0
"""What the agreement of a mesh's outlines with the masks means."""

from __future__ import annotations

from robir.geometry.given.placing import FITS, Agreement

UNRELATED = 0.5
"""Share of outline and mask that both have, below which a mesh shows something else."""

MOST_APART = 0.8
"""Share of the masks that a mesh within them may lack, or of it that may lie beyond them all."""

LIKELY = 0.75
"""Share that a place has at least which is proposed."""


def is_related(agreement: Agreement) -> bool:
    """Whether a mesh shows the object, or a part of it, or it and more, at the right place."""
    wrong = sorted((agreement.missing, agreement.beyond))
    return agreement.share >= UNRELATED or (wrong[0] <= 1 - FITS and wrong[1] < MOST_APART)


def poor_fit(agreement: Agreement) -> tuple[str, ...]:
    """What is to be said of a mesh that stands right and yet is not what the masks show."""
    if agreement.share >= FITS:
        return ()
    parts = []
    if agreement.missing > 1 - FITS:
        parts.append(
            f"it lacks {agreement.missing:.0%} of what the masks show, of which nothing is made"
        )
    if agreement.beyond > 1 - FITS:
        parts.append(
            f"{agreement.beyond:.0%} of its outline lies beyond the masks; that part only shades"
        )
    return (f"The mesh fits the masks by {agreement.share:.0%} only: {' and '.join(parts)}.",)
