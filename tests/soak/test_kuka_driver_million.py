"""A million mutated telegrams through the driver's codec, and a hundred thousand through its session."""

from __future__ import annotations

import pytest
from rsi_mutants import answer_mutants, read_mutants

pytestmark = [pytest.mark.soak, pytest.mark.timeout(3600)]

MILLION = 1_000_000
IN_A_SESSION = 100_000
SHARES = 10  # each with a seed of its own, so that several workers take part


@pytest.mark.parametrize("seed", range(200, 200 + SHARES))
def test_a_million_mutants_are_read_or_refused(seed: int) -> None:
    read, refused = read_mutants(MILLION // SHARES, seed)
    assert read > 0
    assert refused > 0


@pytest.mark.parametrize("seed", range(300, 300 + SHARES))
def test_a_hundred_thousand_mutants_in_sessions_move_nothing(seed: int) -> None:
    answered, refused = answer_mutants(IN_A_SESSION // SHARES, seed)
    assert answered > 0
    assert refused > 0
