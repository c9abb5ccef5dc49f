"""The link follows its telegrams to the processor that receives them, and is otherwise not pinned."""

from __future__ import annotations

import os

import pytest

from ronna_hw.host.real_time import ProcessorAffinity

EVERYWHERE = {0, 1, 2}


class System:
    """Grants what is asked, or refuses it."""

    def __init__(self, monkeypatch: pytest.MonkeyPatch) -> None:
        self.granted: list[set[int]] = []
        self.refuses = False
        monkeypatch.setattr(os, "sched_getaffinity", lambda _thread: set(EVERYWHERE))
        monkeypatch.setattr(os, "sched_setaffinity", self._set)

    def _set(self, _thread: int, allowed: set[int]) -> None:
        if self.refuses:
            raise OSError
        self.granted.append(allowed)


@pytest.fixture
def system(monkeypatch: pytest.MonkeyPatch) -> System:
    return System(monkeypatch)


@pytest.mark.parametrize(
    ("follows", "telegrams_on", "granted"),
    [
        pytest.param(True, [2] * 10, [{2}], id="it moves once and stays there"),
        pytest.param(True, [1, 1, 0, 1, 2, 1, 0, 1], [{1}], id="one telegram elsewhere moves nothing"),
        pytest.param(True, [-1] * 10, [], id="unknown processor"),
        pytest.param(True, [7] * 10, [], id="processor that is not ours"),
        pytest.param(False, [1] * 10, [], id="process without real-time priority"),
    ],
)
def test_the_link_moves_to_the_processor_of_consecutive_telegrams(
    system: System, follows: bool, telegrams_on: list[int], granted: list[set[int]]
) -> None:
    processor = ProcessorAffinity(follows=follows)
    for each in telegrams_on:
        processor.follow(each)
    assert system.granted == granted


def test_freeing_restores_the_original_affinity_once(system: System) -> None:
    processor = ProcessorAffinity(follows=True)
    processor.free()
    processor.follow(1)
    processor.follow(1)
    processor.free()
    processor.free()
    assert system.granted == [{1}, EVERYWHERE]


@pytest.mark.parametrize(
    ("has_priority", "telegrams_on", "granted"),
    [
        pytest.param(True, [1, 1, 1], [EVERYWHERE - {1}], id="it leaves once"),
        pytest.param(True, [1, 2, -1, 7], [EVERYWHERE - {1}, EVERYWHERE - {2}], id="and follows a move only"),
        pytest.param(False, [1], [], id="process without real-time priority"),
    ],
)
def test_in_lock_step_the_sender_has_its_processor_for_itself(
    system: System, has_priority: bool, telegrams_on: list[int], granted: list[set[int]]
) -> None:
    processor = ProcessorAffinity(follows=has_priority)
    for each in telegrams_on:
        processor.avoid(each)
    assert system.granted == granted


def test_a_refused_affinity_is_not_requested_again(system: System) -> None:
    processor = ProcessorAffinity(follows=True)
    system.refuses = True
    processor.follow(1)
    processor.follow(1)
    system.refuses = False
    for _ in range(10):
        processor.follow(2)
    assert system.granted == []
