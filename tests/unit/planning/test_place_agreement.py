"""The map of cart places against the path check itself, at fewer random places than the benchmark's."""

from __future__ import annotations

import pytest

from benchmarks.place_map import agreement, cart_case

PLACES, WITHIN_MM = 100, 240.0


@pytest.mark.slow
@pytest.mark.timeout(600)
@pytest.mark.hazard(48)
@pytest.mark.parametrize("turn_deg", [0.0, 15.0])
def test_the_path_check_refuses_no_place_of_the_map_and_few_are_lost(turn_deg: float) -> None:
    found = agreement(cart_case("mini"), PLACES, WITHIN_MM, turn_deg, workers=1)
    assert found.refused == 0
    assert found.lost <= 0.05 * PLACES
    assert 0 < found.allowed < PLACES
