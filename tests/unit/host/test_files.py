"""Too few file descriptors are reported at the start, with the number required."""

from __future__ import annotations

import resource

import pytest
from coded_errors import raises

from ronna_hw.host.files import TOO_FEW_OPEN_FILES, require_open_files


@pytest.fixture
def limits(monkeypatch: pytest.MonkeyPatch) -> list[tuple[int, int]]:
    """The limits of this program, soft and hard; the last are in force."""
    kept = [(64, 4096)]
    monkeypatch.setattr(resource, "getrlimit", lambda _what: kept[-1])
    monkeypatch.setattr(resource, "setrlimit", lambda _what, limits: kept.append(limits))
    return kept


def test_a_soft_limit_is_raised_as_far_as_required(limits: list[tuple[int, int]]) -> None:
    require_open_files(50)
    assert limits[1:] == []
    require_open_files(96)
    assert limits[1:] == [(96, 4096)]


def test_a_hard_limit_that_is_too_low_is_reported_with_the_number_required(
    limits: list[tuple[int, int]],
) -> None:
    limits.append((64, 64))
    with raises(TOO_FEW_OPEN_FILES, match=r"PRC-002: the limit of open files .* expected 96, got 64"):
        require_open_files(96)
