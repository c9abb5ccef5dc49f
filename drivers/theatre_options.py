"""Validation of driver options in the theatre file."""

from __future__ import annotations

import json
import os
from collections.abc import Mapping
from typing import Any, TypeVar

from pydantic import BaseModel, ValidationError

from ronna_hw.errors import ConfigurationError
from ronna_hw.mistakes import describe_mistakes
from ronna_hw.text import format_count

M = TypeVar("M", bound=BaseModel)


def parse_options(
    model: type[M], options: Mapping[str, Any], subject: str, refusal: type[ConfigurationError]
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
