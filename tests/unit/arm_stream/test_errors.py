"""One table of errors for all streams: each make has every row under codes of its own, which never change."""

from __future__ import annotations

import pytest

from drivers.kuka_rsi.errors import STREAM_ERRORS as KUKA
from drivers.universal_robots.errors import STREAM_ERRORS as UR
from ronna_hw.arm_stream.errors import ControllerNotFound, MakeRow, StreamErrors, StreamWords

CODES = {
    "not_found": ("EKI-001", "URD-002"),
    "lost": ("EKI-002", "URD-014"),
    "no_answer": ("EKI-003", "URD-015"),
    "not_started": ("RSI-001", "URD-020"),
    "died": ("RSI-007", "URD-024"),
    "stalled": ("RSI-020", "URD-025"),
    "silent": ("RSI-003", "URD-021"),
    "heartbeat_late": ("RSI-006", "URD-023"),
    "tripped": ("RSI-005", "URD-026"),
    "path_failed": ("RSI-016", "URD-027"),
    "unusable": ("RSI-019", "URD-028"),
    "protective_stop": ("RSI-009", "URD-029"),
    "link_stopped": ("RSI-004", "URD-030"),
    "drives_off": ("EKI-009", "URD-031"),
    "stopped": ("RSI-010", "URD-032"),
    "not_finished": ("RSI-011", "URD-033"),
    "refused": ("RSI-012", "URD-034"),
}
NO_WORDS = StreamWords(clock="", message="", answers="", stop="")


def test_each_make_has_every_error_of_the_table_under_its_own_code() -> None:
    kuka, ur = KUKA.rows(), UR.rows()
    assert {name: (kuka[name].code, ur[name].code) for name in kuka | ur} == CODES


def test_an_error_is_of_the_same_kind_and_says_something_in_each_make() -> None:
    for kuka, ur in zip(KUKA.rows().values(), UR.rows().values(), strict=True):
        assert kuka.kind is ur.kind
        assert kuka.meaning
        assert ur.meaning


def test_the_kind_is_caught_whatever_the_make() -> None:
    for errors in (KUKA, UR):
        with pytest.raises(ControllerNotFound):
            raise errors.not_found("nothing answers")


def test_a_make_without_a_code_for_an_error_is_refused() -> None:
    with pytest.raises(KeyError):
        StreamErrors(NO_WORDS, {})


def test_a_make_with_a_code_for_an_unknown_error_is_refused(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("ronna_hw.errors.ErrorCode.known", {})
    with pytest.raises(TypeError, match="gone"):
        StreamErrors(NO_WORDS, {name: MakeRow(name) for name in (*CODES, "gone")})
