"""Two arms are measured against each other: both brought home before, in postures near those of the work."""

from __future__ import annotations

from collections.abc import Callable
from types import SimpleNamespace
from typing import cast

import numpy as np
import pytest

from procedures.steps.clinical.two_arms import base_to_base
from procedures.steps.clinical.two_arms.base_postures import (
    FLANGE_ONWARDS,
    face_along,
    order_by_travel,
    turn_towards,
)
from procedures.steps.clinical.two_arms.base_to_base import bring_arms_home
from procedures.steps.clinical.two_arms.base_visits import ArmVisits
from ronna_hw.roles import ASSISTANT, MASTER


@pytest.fixture
def done(monkeypatch: pytest.MonkeyPatch) -> list[str]:
    monkeypatch.setattr(base_to_base, "surround_stereo_head", lambda *_: None)
    return []


def visits(done: list[str], *out: str, base: object | None = "as before") -> ArmVisits:
    def noting(what: str) -> Callable[..., None]:
        return lambda *_: done.append(what)

    def arm(name: str) -> SimpleNamespace:
        place = SimpleNamespace(is_out=name in out)
        history = SimpleNamespace(base=base, base_uncertain_mm=20.0)
        return SimpleNamespace(place=place, history=history, base=base, return_home=noting(f"{name} home"))

    master, assistant = arm("master"), arm("assistant")
    master.joints_rad = lambda: None
    assistant.place_base = lambda _base, uncertain_mm: done.append(f"place within {uncertain_mm:g} mm")
    assistant.surround = noting("surround")
    arms = {MASTER: master, ASSISTANT: assistant}
    cell = SimpleNamespace(
        master=master, assistant=assistant, arms=arms, is_any_arm_out=bool(out), start=noting("start")
    )
    made = SimpleNamespace(cell=cell, assistant=assistant, context=None, around=lambda: None)
    return cast("ArmVisits", made)


def test_arms_that_a_fault_left_away_go_home_with_what_surrounds_them_known(done: list[str]) -> None:
    bring_arms_home(visits(done, "master", "assistant"))
    assert done == ["place within 20 mm", "start", "surround", "master home", "assistant home"]


def test_an_arm_at_home_stays_there(done: list[str]) -> None:
    bring_arms_home(visits(done, "assistant"))
    assert done[-2:] == ["surround", "assistant home"]


@pytest.mark.parametrize(("out", "base"), [((), "as before"), (("assistant",), None)])
def test_nothing_moves_if_both_are_home_or_no_earlier_attempt_knew_the_bases(
    done: list[str], out: tuple[str, ...], base: object | None
) -> None:
    bring_arms_home(visits(done, *out, base=base))
    assert done == []


STILL = (0.0,) * 5


def test_each_posture_is_the_one_nearest_to_the_previous_one() -> None:
    postures = [(turn_rad, *STILL) for turn_rad in (0.9, -0.3, 0.2, 2.0)]
    assert [first for first, *_ in order_by_travel((0.0, *STILL), postures)] == [0.2, -0.3, 0.9, 2.0]


def test_the_flange_is_turned_only_as_far_as_the_instrument_needs() -> None:
    inwards = np.array((0.1, 0.2, -1.0))
    held = face_along((1.0, 0.0, 0.0), inwards)
    assert held.apply((1.0, 0.0, 0.0)) == pytest.approx(inwards / np.linalg.norm(inwards))
    between_rad = np.arctan2(np.hypot(0.1, 0.2), 1.0)
    assert (FLANGE_ONWARDS.inv() * held).magnitude() == pytest.approx(between_rad)


@pytest.mark.parametrize("wanted", [(1.0, 0.0, 0.0), (0.0, 0.0, 1.0), (0.0, 0.0, -1.0), (0.3, -0.4, -2.0)])
def test_a_direction_is_turned_onto_any_other_also_onto_its_opposite(wanted: tuple[float, ...]) -> None:
    turned = turn_towards((0.0, 0.0, 2.0), wanted, np.pi).apply((0.0, 0.0, 1.0))
    assert turned == pytest.approx(np.array(wanted) / np.linalg.norm(wanted))
