"""The link follows its telegrams to the processor that takes them in, and is tied to none otherwise."""

from __future__ import annotations

import os

import pytest

from ronna_hw.host.processor_affinity import SURE_AFTER_TELEGRAMS, ProcessorAffinity

EVERYWHERE = {0, 1, 2}


class System:
    """Grants what is asked, or refuses it."""

    def __init__(self, monkeypatch: pytest.MonkeyPatch, processors: set[int] = EVERYWHERE) -> None:
        self.kept: list[set[int]] = []
        self.refuses = False
        monkeypatch.setattr(os, "sched_getaffinity", lambda _thread: set(processors))
        monkeypatch.setattr(os, "sched_setaffinity", self._set)

    def _set(self, _thread: int, allowed: set[int]) -> None:
        if self.refuses:
            raise OSError
        self.kept.append(allowed)


def test_it_moves_when_telegrams_come_by_another_processor_and_stays_there(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    system = System(monkeypatch)
    processor = ProcessorAffinity(follows=True)
    for _ in range(10):
        processor.follow(2)
    assert system.kept == [{2}]


def test_one_telegram_by_another_processor_moves_nothing(monkeypatch: pytest.MonkeyPatch) -> None:
    system = System(monkeypatch)
    processor = ProcessorAffinity(follows=True)
    for _ in range(SURE_AFTER_TELEGRAMS):
        processor.follow(1)
    for odd in (0, 1, 2, 1, 0, 1):
        processor.follow(odd)
    assert system.kept == [{1}]


def test_set_free_it_goes_elsewhere_and_may_then_run_anywhere_it_might_before(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    system = System(monkeypatch)
    processor = ProcessorAffinity(follows=True)
    for _ in range(SURE_AFTER_TELEGRAMS):
        processor.follow(1)
    processor.free()
    processor.free()
    assert system.kept == [{1}, EVERYWHERE - {1}, EVERYWHERE]


@pytest.mark.parametrize("elsewhere", [-1, 7])
def test_a_processor_unknown_or_not_ours_is_not_followed(
    monkeypatch: pytest.MonkeyPatch, elsewhere: int
) -> None:
    system = System(monkeypatch)
    processor = ProcessorAffinity(follows=True)
    for _ in range(10):
        processor.follow(elsewhere)
    assert system.kept == []


def test_a_process_that_does_not_run_first_is_left_alone(monkeypatch: pytest.MonkeyPatch) -> None:
    system = System(monkeypatch)
    processor = ProcessorAffinity(follows=False)
    for _ in range(10):
        processor.follow(1)
    processor.free()
    assert system.kept == []


def test_a_refusal_is_accepted_and_nothing_more_is_asked(monkeypatch: pytest.MonkeyPatch) -> None:
    system = System(monkeypatch)
    processor = ProcessorAffinity(follows=True)
    system.refuses = True
    for _ in range(SURE_AFTER_TELEGRAMS):
        processor.follow(1)
    system.refuses = False
    for _ in range(10):
        processor.follow(2)
    assert system.kept == []
