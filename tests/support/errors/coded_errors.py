"""Expectation of an error: by its class, or by its code where it is a row of a table."""

from __future__ import annotations

from typing import Any

import pytest

from ronna_hw.errors import ErrorCode, is_error


def raises(*expected: ErrorCode[Any] | type[Exception], match: str | None = None) -> pytest.RaisesExc[Any]:
    """Expect one of these errors, and that its message fits."""
    return pytest.raises(Exception, match=match, check=lambda error: is_error(error, *expected))
