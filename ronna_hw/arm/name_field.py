"""Pydantic field for the name of an arm."""

from __future__ import annotations

from pydantic import GetPydanticSchema
from pydantic_core import core_schema

from ronna_hw.arm.catalogue import ARMS


def arm_of(*makes: str) -> GetPydanticSchema:
    """Restrict a text field to the built-in arms of these makes."""
    names = [arm.name for arm in ARMS.values() if arm.make in makes]
    return GetPydanticSchema(lambda _source, _handler: core_schema.literal_schema(names))
