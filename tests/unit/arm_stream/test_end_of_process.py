"""Message about a real-time process that ended by itself."""

from __future__ import annotations

import pytest

from ronna_hw.arm_stream.client import raised_line

TRACEBACK = """Traceback (most recent call last):
  File "loop.py", line 10, in run
    step()
  File "path.py", line 4, in step
    raise PATH_FAILED("no solution")
PATH_FAILED: no solution
"""


@pytest.mark.parametrize(
    ("text", "line"),
    [
        (TRACEBACK, "PATH_FAILED: no solution"),
        (TRACEBACK + 'library: leaked 3 types!\n - leaked type "Result"\n', "PATH_FAILED: no solution"),
        ("warning\nbad option", "bad option"),
        ("Traceback (most recent call last):\n  cut sho", "  cut sho"),
    ],
)
def test_the_exception_is_named_whatever_libraries_write_after_it(text: str, line: str) -> None:
    assert raised_line(text) == line
