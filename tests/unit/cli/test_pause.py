import io

import pytest

from procedures.cli.case.pause import Pause
from procedures.engine.errors import OperatorAborted


def test_without_a_wish_a_safe_point_is_passed(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("sys.stdin", io.StringIO("abort\n"))
    Pause().safe_point()


def test_after_one_wish_enter_goes_on_and_the_wish_is_spent(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("sys.stdin", io.StringIO("\nabort\n"))
    pause = Pause()
    pause.ask()
    pause.safe_point()
    pause.safe_point()
    assert not pause.wanted


@pytest.mark.parametrize("answer", ["abort\n", ""])
def test_abort_or_the_end_of_the_input_ends_the_procedure(
    monkeypatch: pytest.MonkeyPatch, answer: str
) -> None:
    monkeypatch.setattr("sys.stdin", io.StringIO(answer))
    pause = Pause()
    pause.ask()
    with pytest.raises(OperatorAborted, match="PRO-004"):
        pause.safe_point()


def test_the_second_wish_stops_now() -> None:
    pause = Pause()
    pause.ask()
    with pytest.raises(KeyboardInterrupt):
        pause.ask()
