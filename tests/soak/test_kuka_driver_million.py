"""A hundred thousand mutated telegrams through a session of the driver."""

from __future__ import annotations

import pytest
from rsi_loop import answer_mutants

pytestmark = [pytest.mark.soak, pytest.mark.timeout(3600)]

IN_A_SESSION = 100_000
SHARES = 10  # each with a seed of its own, so that several workers take part


@pytest.mark.parametrize("seed", range(300, 300 + SHARES))
def test_a_hundred_thousand_mutants_in_sessions_move_nothing(seed: int) -> None:
    answered, refused = answer_mutants(IN_A_SESSION // SHARES, seed)
    assert answered > 0
    assert refused > 0
