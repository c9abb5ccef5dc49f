"""A million mutants for every parser of external input."""

from __future__ import annotations

from pathlib import Path

import pytest
from bounded_cost import bounded_cost
from good_inputs import PARSER_NAMES
from hostile_inputs import feed, parsers
from memory_folder import memory_folder

pytestmark = [pytest.mark.soak, pytest.mark.timeout(3600)]

MILLION = 1_000_000
SHARES = 10  # each with a seed of its own, so that several workers take part


@pytest.mark.parametrize("seed", range(400, 400 + SHARES))
@pytest.mark.parametrize("name", PARSER_NAMES)
def test_a_million_mutants_cost_a_bounded_amount(tmp_path: Path, name: str, seed: int) -> None:
    with memory_folder(tmp_path) as folder:
        parser = parsers(folder)[name]
        with bounded_cost(limit_s=3600.0):  # each has its own limit
            feed(parser, MILLION // SHARES, seed)
