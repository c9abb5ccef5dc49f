"""A real browser at a real console of a real case. Never beside tests of the robot's link: it is greedy."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest
from modest_chromium import MISSING, modest_chromium, opened_context
from operated_case import OperatedCase, OperatedCases, operated_cases

HANG_S = 600.0  # only ends what hangs: nine pages drawn by the processor take 90 s on two cores


def pytest_collection_modifyitems(items: list[pytest.Item]) -> None:
    for item in items:
        if "browser" in item.path.parts:
            item.add_marker(pytest.mark.browser)
            if item.get_closest_marker("timeout") is None:
                item.add_marker(pytest.mark.timeout(HANG_S))
            if MISSING:
                item.add_marker(pytest.mark.skip(reason=MISSING))


@pytest.fixture(scope="session")
def browser(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Any]:
    """Chromium."""
    with modest_chromium(tmp_path_factory.mktemp("chromium")) as browser:
        yield browser


@pytest.fixture
def page(browser: Any) -> Iterator[Any]:
    """A page of its own, which notes where its requests go and what its scripts complain about."""
    context = opened_context(browser, viewport={"width": 1280, "height": 720})
    page = context.new_page()
    page.requested, page.complaints = [], []
    page.on("request", lambda request: page.requested.append(request.url))
    page.on("pageerror", lambda error: page.complaints.append(str(error)))
    yield page
    context.close()


@pytest.fixture
def start(tmp_path: Path) -> Iterator[OperatedCases]:
    """Start `ronna-procedure ARGUMENTS --sim --scene mini --seed 3 --console`; ended with the test."""
    with operated_cases(tmp_path) as start:
        yield start


@pytest.fixture(scope="session")
def alone(tmp_path_factory: pytest.TempPathFactory) -> OperatedCase:
    """The case of `start`, come to its end with nothing that shows it: run once for all tests."""
    with operated_cases(tmp_path_factory.mktemp("alone")) as start:
        return start.without_console()
