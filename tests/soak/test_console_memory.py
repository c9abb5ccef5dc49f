"""A console viewed for half an hour, by people who come and go, needs no more memory than at first."""

from pathlib import Path

import pytest
from console_memory import memory_by_minute
from modest_chromium import MISSING

pytestmark = [pytest.mark.soak, pytest.mark.timeout(2400)]

MINUTES = 30
SETTLED = 5  # minutes in which caches fill
MOST_GROWTH_MB = 15.0  # in all of the rest; a page that stayed would be a megabyte each, of hundreds


@pytest.mark.skipif(MISSING is not None, reason=MISSING or "")
def test_opening_and_closing_tabs_does_not_grow_the_memory_of_the_server(tmp_path: Path) -> None:
    found = memory_by_minute(tmp_path, MINUTES)
    assert found[-1].tabs > 100
    assert found[-1].megabytes - found[SETTLED - 1].megabytes < MOST_GROWTH_MB, found
