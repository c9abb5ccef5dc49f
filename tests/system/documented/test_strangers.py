"""The page of strangers says what they do: each asked case has its row, and a sample is run again."""

from __future__ import annotations

from pathlib import Path

import pytest
from run_strangers import run_client
from stranger_catalogue import CLIENTS, SERVERS, Client
from strangers_table import PASSES, Result, read_results

RESULTS = {one.name: one for one in read_results()}
HANGS = "does not end"  # for half a minute


def sample(result: Result) -> list[str]:
    """The first case that passes, and the first that fails without hanging."""
    first = {
        outcome == PASSES: name for name, outcome in reversed(result.cases.items()) if HANGS not in outcome
    }
    return [*first.values()]


@pytest.mark.parametrize("client", CLIENTS, ids=lambda client: client.name)
def test_each_case_that_a_program_has_is_on_the_page_and_no_other(client: Client) -> None:
    asked = {case.name for case in client.protocol.cases} & set(client.sources())
    assert set(RESULTS[client.name].cases) == asked
    assert set(client.reports) <= asked


def test_each_stranger_is_on_the_page_and_each_case_is_asked_of_one() -> None:
    assert {one.name for one in (*CLIENTS, *SERVERS)} == set(RESULTS)
    for protocol in dict.fromkeys(one.protocol for one in CLIENTS):
        asked = {name for one in CLIENTS if one.protocol is protocol for name in one.sources()}
        assert {case.name for case in protocol.cases} <= asked


@pytest.mark.slow
@pytest.mark.parametrize("client", CLIENTS, ids=lambda client: client.name)
def test_a_stranger_does_again_as_the_page_says(client: Client, tmp_path: Path) -> None:
    kept = RESULTS[client.name]
    if (version := client.version()) != kept.version:
        pytest.skip(f"left out: {client.name} {kept.version} is on the page, {version} is installed")
    names = sample(kept)
    found = run_client(client, version, tmp_path, names)
    assert found.cases == {name: kept.cases[name] for name in names}
