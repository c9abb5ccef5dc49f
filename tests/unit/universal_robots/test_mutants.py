"""Mutants of what a controller sends: they move nothing, and are refused in words where they are no good."""

from __future__ import annotations

import pytest
from driver_inputs import DASHBOARD_LINES, OUTPUT_PACKAGE, PRIMARY_STATE, SETUP_REPLIES, driver_parsers
from mutations import mutations

from ronna_hw.bounded_input import InputRefused
from ronna_hw.errors import RonnaError

IN_A_RUN = 600
IN_A_SOAK, SHARES = 1_000_000, 10
ORIGINALS = {
    "RTDE": (OUTPUT_PACKAGE,),
    "RTDE set-up": (SETUP_REPLIES,),
    "UR dashboard": (DASHBOARD_LINES,),
    "UR primary": (PRIMARY_STATE,),
}


def take_mutants(name: str, count: int, seed: int) -> tuple[int, int]:
    """Count mutants taken and refused; anything else that is raised fails the test."""
    _, take = driver_parsers()[name]
    taken = refused = 0
    for mutant in mutations(ORIGINALS[name], count, seed):
        try:
            take(mutant)
            taken += 1
        except (InputRefused, RonnaError):
            refused += 1
    return taken, refused


@pytest.mark.parametrize("name", ORIGINALS)
def test_mutants_move_nothing_and_are_refused_in_words(name: str) -> None:
    assert all(take_mutants(name, IN_A_RUN, seed=1))


@pytest.mark.soak
@pytest.mark.timeout(7200)
@pytest.mark.parametrize("name", ORIGINALS)
@pytest.mark.parametrize("seed", range(10, 10 + SHARES))
def test_a_million_mutants_move_nothing(name: str, seed: int) -> None:
    assert all(take_mutants(name, IN_A_SOAK // SHARES, seed))
