"""The evidence shown with a question."""

from __future__ import annotations

from pydantic import BaseModel, ConfigDict


class Evidence(BaseModel):
    """A table that a question is decided by, as it is shown: text, with its units."""

    model_config = ConfigDict(frozen=True, extra="forbid", allow_inf_nan=False)

    title: str
    head: tuple[str, ...]
    rows: tuple[tuple[str, ...], ...]
