"""A sphere that was implanted and is not used."""

from __future__ import annotations

from pydantic import Field

from procedures.journal.results import Values


class LeftOutSphere(Values):
    """A sphere that a registration does without, as the operator agreed."""

    fiducial: int = Field(description="Index of the sphere in the CT.")
    reason: str = Field(description="Why.")
