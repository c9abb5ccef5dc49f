"""The map of cart places: every place it allows works, and few usable places are lost."""

from __future__ import annotations

import math
import os
import signal
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from multiprocessing import active_children, get_context
from typing import cast

import numpy as np
import psutil
import pytest
from coded_errors import raises
from waiting import HANG_LIMIT_S, eventually

from procedures.planning.cart_map import map_places, open_judge, propose_place
from procedures.planning.cart_place import CartCase, CartMove, PlaceSolution, PlaceVerdict
from procedures.planning.errors import NO_PLACE
from procedures.planning.proposed_place import TURNED_SHARE, ProposedPlace
from ronna_hw.arm.pose import Pose
from ronna_hw.frames import Frame, Transform
from ronna_hw.host import worker_processes
from ronna_hw.host.child_process import ChildNotReady

WITHIN_MM = 240.0
FOUND = PlaceSolution(2, (("T1", 0.0),))
Asked = Sequence[tuple[CartMove, tuple[PlaceSolution, ...], bool]]


def _judge(
    serves: Callable[[float, float], bool],
) -> tuple[Callable[[Asked], list[PlaceVerdict]], list[CartMove]]:
    asked: list[CartMove] = []

    def judge(moves: Asked) -> list[PlaceVerdict]:
        asked.extend(move for move, _, _ in moves)
        return [
            PlaceVerdict(FOUND if serves(move.x_mm, move.y_mm) else None, "T1/target", "too far [ARM-001]")
            for move, _, _ in moves
        ]

    return judge, asked


def _disc(x_mm: float, y_mm: float) -> bool:
    return (x_mm - 60.0) ** 2 + (y_mm + 40.0) ** 2 < 150.0**2


@pytest.mark.hazard(48)
def test_every_allowed_place_works_and_at_most_one_in_twenty_is_lost() -> None:
    judge, asked = _judge(_disc)
    places = map_places(WITHIN_MM, judge)
    random = np.random.default_rng(1).uniform(-WITHIN_MM, WITHIN_MM, (1000, 2))
    allowed = np.array([places.allows(x, y) for x, y in random])
    true = np.array([_disc(x, y) for x, y in random])
    assert not (allowed & ~true).any()
    assert (true & ~allowed).sum() <= 50
    assert len(asked) == len({(move.x_mm, move.y_mm) for move in asked}) < 400  # each is judged once


def test_the_best_place_is_central_and_states_how_far_off_still_works() -> None:
    judge, _ = _judge(_disc)
    found = propose_place(map_places(WITHIN_MM, judge), judge)
    assert np.hypot(found.best.x_mm - 60.0, found.best.y_mm + 40.0) < 25.0
    assert 110.0 < found.free_mm <= 150.0
    for angle in np.linspace(0.0, 2.0 * np.pi, 60):
        x = found.best.x_mm + found.free_mm * np.cos(angle)
        assert _disc(x, found.best.y_mm + found.free_mm * np.sin(angle))
    assert found.turns_deg == (15.0, 15.0)
    assert found.assumed.serves


def test_a_head_posed_as_proposed_is_nowhere_beside_its_place() -> None:
    place = ProposedPlace(
        series_instance_uid="1.2.3",
        assumed_robot_from_ct=(700.0, 30.0, 100.0, -90.0, 5.0, -80.0),
        best_mm=(60.0, -40.0),
        turned_deg=15.0,
        free_mm=30.0,
        turns_deg=(5.0, 5.0),
    )
    pose = Pose.from_kuka(*place.robot_from_ct)
    there = Transform.of(
        Frame.ROBOT, Frame.CT, translation_mm=pose.position_mm, quaternion_wxyz=pose.quaternion()
    )
    drift = place.drift(there)
    assert (drift.off_mm, drift.turned_deg, drift.head_mm) == pytest.approx((0.0, 0.0, 0.0), abs=1e-6)


@pytest.mark.hazard(48)
def test_no_place_beyond_the_map_is_called_reachable() -> None:
    judge, _ = _judge(lambda x, y: True)
    places = map_places(WITHIN_MM, judge)
    assert places.allows(0.0, WITHIN_MM - 1.0)
    assert not places.allows(0.0, WITHIN_MM + 1.0)


def _serves_turned(move: CartMove) -> bool:
    """At the place itself turned by less than 7 degrees, and the farther off the less."""
    return abs(math.degrees(move.turn_rad) - 20.0) < 7.0 - math.hypot(move.x_mm, move.y_mm) / 50.0


def test_a_turned_cart_states_how_far_off_and_turned_it_still_works() -> None:
    asked: list[CartMove] = []

    def judge(moves: Asked) -> list[PlaceVerdict]:
        asked.extend(move for move, _, _ in moves)
        return [PlaceVerdict(FOUND if _serves_turned(move) else None) for move, _, _ in moves]

    places = map_places(WITHIN_MM, judge, turn_rad=math.radians(20.0))
    assert {move.turn_rad for move in asked} == {places.turn_rad}
    found = propose_place(places, judge)
    assert found.best.turn_rad == places.turn_rad
    assert max(found.turns_deg) < 7.0  # which only the place itself bears
    less, more = found.turns_deg
    for turn_deg in (-less, more):
        for angle in np.linspace(0.0, 2.0 * np.pi, 8):
            x, y = found.free_mm * TURNED_SHARE * np.array([np.cos(angle), np.sin(angle)])
            turn_rad = places.turn_rad + math.radians(turn_deg)
            assert _serves_turned(CartMove(found.best.x_mm + x, found.best.y_mm + y, turn_rad))


def test_a_solution_known_from_a_neighbouring_place_is_passed_on() -> None:
    knew: dict[tuple[float, float], int] = {}

    def judge(moves: Asked) -> list[PlaceVerdict]:
        knew.update({(move.x_mm, move.y_mm): len(known) for move, known, _ in moves})
        return [PlaceVerdict(FOUND) for _ in moves]

    map_places(WITHIN_MM, judge)
    assert [place for place, known in knew.items() if not known] == [(0.0, 0.0)]


def test_a_map_without_any_usable_place_is_refused_with_the_commonest_reason() -> None:
    judge, _ = _judge(lambda x, y: False)
    with raises(NO_PLACE, match="too far"):
        propose_place(map_places(WITHIN_MM, judge), judge)


WORKERS = 2


@dataclass(frozen=True)
class _Unjudged:
    """A case whose positions take for ever."""

    halted: bool

    def judge(self, *_: object, search: bool) -> PlaceVerdict:
        if self.halted:
            os.kill(os.getpid(), signal.SIGSTOP)
        while True:
            signal.pause()


def _judge_elsewhere(halted: bool) -> None:
    with open_judge(cast("CartCase", _Unjudged(halted)), WORKERS) as judge:
        judge([(CartMove(0.0, 0.0), (), False)] * 100)


@pytest.mark.slow
def test_halted_judges_end_the_search(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(worker_processes, "IDLE_TIMEOUT_S", 1.0)
    before = set(active_children())
    with pytest.raises(ChildNotReady, match="PRC-001: the worker processes do not finish"):
        _judge_elsewhere(halted=True)
    assert set(active_children()) <= before


@pytest.mark.slow
def test_judges_end_with_a_killed_search() -> None:
    search = get_context("spawn").Process(target=_judge_elsewhere, args=(False,))
    search.start()
    seen = psutil.Process(search.pid)
    eventually(lambda: len(seen.children()) == WORKERS)
    judges = seen.children()
    search.kill()
    search.join()
    assert psutil.wait_procs(judges, HANG_LIMIT_S)[1] == []
