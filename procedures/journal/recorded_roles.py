"""Roles of a case's arms as request files and tapes have them. Free of numerics, for commands that begin."""

from __future__ import annotations

from typing import Annotated

from pydantic import AliasChoices, BeforeValidator, Field

from ronna_hw.roles import CASES, TWO_ARMS, roles_of


def _read_roles(told: object) -> object:
    """Return roles as told; older files only say whether there is an assistant."""
    if isinstance(told, bool):
        return roles_of(dual=told)
    roles = tuple(told) if isinstance(told, list) else told
    if roles not in CASES:
        raise ValueError(f"expected the roles of one arm or of two: {', '.join(TWO_ARMS)}")
    return roles


RecordedRoles = Annotated[
    tuple[str, ...],
    BeforeValidator(_read_roles),
    Field(validation_alias=AliasChoices("roles", "dual"), description="Roles of the arms, the master first."),
]
