"""Validation of driver options in the theatre file."""

from __future__ import annotations

import json
import os
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from typing import Any, TypeVar

from pydantic import BaseModel, ValidationError

from ronna_hw.config import BadTheatreFile, DeviceConfig, Role
from ronna_hw.errors import AnyCode, ConfigurationError
from ronna_hw.mistakes import describe_mistakes
from ronna_hw.text import format_count

M = TypeVar("M", bound=BaseModel)
ANOTHER_MAKE = "Correct the options and endpoints, or the driver if they are those of another make."


def parse_options(
    model: type[M], options: Mapping[str, Any], subject: str, refusal: AnyCode[ConfigurationError]
) -> M:
    """Validate the options of one device; raises `refusal` listing every mistake."""
    try:
        # via JSON: strict types, but text is accepted for paths, lists for tuples and integers for floats
        return model.model_validate_json(json.dumps(options, default=os.fspath))
    except ValidationError as error:
        mistakes = describe_mistakes(error, model)
        summary = f"{subject} have {format_count(len(mistakes), 'mistake')}: {'; '.join(mistakes)}"
        raise refusal(summary) from error
    except TypeError as error:
        raise refusal(f"{subject}: {error}") from error


@contextmanager
def naming_endpoints_too(device: str, config: DeviceConfig, roles: Mapping[str, Role]) -> Iterator[None]:
    """Add what is wrong with the endpoints to a refusal of options: a driver of another make has neither."""
    try:
        yield
    except ConfigurationError as of_options:
        try:
            config.require_addresses(roles, device)
        except BadTheatreFile as of_endpoints:
            raise of_options.reworded(
                f"{of_options.what}; {of_endpoints.what}",
                expected=of_endpoints.expected,
                got=of_endpoints.got,
                action=ANOTHER_MAKE,
            ) from of_options
        raise
