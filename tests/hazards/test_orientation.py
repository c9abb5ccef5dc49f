"""Hazard 7: a CT that was mirrored or turned on its way never places a guide, and an honest one is used."""

from __future__ import annotations

from collections import Counter

import numpy as np
import pytest
from coded_errors import raises
from mirrored_case import LABELS, MIRRORS, TURNS
from oriented_heads import LAYOUTS, OrientedHead, drawn_head

from procedures.registration import MatchStatus, match
from procedures.registration.errors import NO_UNIQUE_MATCH, HeadElsewhere
from procedures.steps.clinical.coarse_match import SIGMA_CT_MM, SIGMA_TRACKER_MM
from sim.world.rigid import apply

RUNS = [20, pytest.param(1000, marks=[pytest.mark.slow, pytest.mark.timeout(600)])]
SPOILT = [
    *((turn, "HFS") for turn in (*MIRRORS.values(), *TURNS.values())),
    *((np.eye(3), one) for one in LABELS),
]


def decided_before(head: OrientedHead) -> bool:
    """Whether the distances alone were taken as an answer."""
    room = np.vstack([apply(head.robot_from_ct, head.image_mm), head.strays_mm])
    sigmas = {"sigma_image_mm": SIGMA_CT_MM, "sigma_physical_mm": SIGMA_TRACKER_MM}
    return match(head.image_mm, room, expected=len(head.image_mm), **sigmas).status is MatchStatus.UNIQUE


@pytest.mark.hazard(7)
@pytest.mark.parametrize("runs", RUNS)
def test_no_mirrored_or_turned_ct_is_registered(runs: int) -> None:
    random, refused = np.random.default_rng(7), Counter[str]()
    for number in range(runs):
        layout, spoilt = LAYOUTS[number % len(LAYOUTS)], SPOILT[number // len(LAYOUTS) % len(SPOILT)]
        head = drawn_head(layout, random).spoilt(*spoilt)
        with raises(NO_UNIQUE_MATCH, HeadElsewhere) as stopped:
            print(layout, *spoilt, head.pair(random))
        refused[stopped.value.code] += 1
    assert sum(refused.values()) == runs


@pytest.mark.hazard(7)
@pytest.mark.parametrize("runs", RUNS)
def test_every_ct_that_its_distances_decided_before_is_registered(runs: int) -> None:
    random, registered = np.random.default_rng(8), 0
    for number in range(runs):
        head = drawn_head(LAYOUTS[number % len(LAYOUTS)], random)
        if not decided_before(head):
            continue
        found = head.pair(random)
        error_mm = np.abs(
            found.robot_from_ct.transform.apply(head.image_mm) - apply(head.robot_from_ct, head.image_mm)
        )
        assert error_mm.max() < 2.0
        registered += 1
    assert registered > 0.95 * runs
