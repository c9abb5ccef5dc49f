import pickle
import re
from pathlib import Path

import pytest
from generate import list_errors_with_code
from hypothesis import given
from hypothesis import strategies as st

from drivers.ndi_polaris.errors import CommandRejected
from ronna_hw.devices.errors import ACKNOWLEDGE
from ronna_hw.errors import LinkTimeout, RonnaError
from ronna_hw.text import format_against_limit, format_distinct

TESTS = Path(__file__).resolve().parents[2]


def test_every_code_is_unique_and_every_error_says_what_to_do() -> None:
    seen: dict[str, str] = {}
    for error in list_errors_with_code():
        assert re.fullmatch(r"[A-Z]{2,5}-\d{3}", error.code), error
        assert error.action, error
        assert error.code not in seen, f"{error.code} is {error.name} and {seen[error.code]}"
        seen[error.code] = error.name
    assert len(seen) > 20


def test_advice_to_recover_a_device_names_the_command_and_the_method() -> None:
    advising = [
        error for error in list_errors_with_code() if re.search(r"\brecover\b", error.action, re.IGNORECASE)
    ]
    assert len(advising) > 15
    assert [error.code for error in advising if ACKNOWLEDGE not in error.action] == []
    assert "ronna-procedure acknowledge RUN --by NAME" in ACKNOWLEDGE
    assert "recover(acknowledged_by)" in ACKNOWLEDGE


def test_every_code_is_mentioned_by_a_test() -> None:
    files = (path for path in TESTS.rglob("*") if path.suffix in (".py", ".txt"))
    tests = "\n".join(path.read_text(encoding="utf-8") for path in files)
    words = set(re.findall(r"\w+(?:-\d{3})?", tests))
    assert [error for error in list_errors_with_code() if not words & {error.code, error.name}] == []


def test_an_error_is_one_line_with_expectation_limit_and_action() -> None:
    error = RonnaError("no answer", expected="OKAY", limit="2 s", got="-", action="Try.", wire=b"\x01\xff")
    assert str(error) == "no answer; expected OKAY, limit 2 s, got -; last bytes 01 ff. Try."


def test_the_action_of_an_error_is_what_its_message_says_to_do() -> None:
    assert RonnaError("no file", action="Give the path.").action == "Give the path."
    rejected = CommandRejected(1, "TX")
    assert rejected.action == rejected.advice == CommandRejected.action


def test_a_value_without_an_expectation_or_limit_follows_a_colon() -> None:
    assert str(RonnaError("no way to the host", got="no route")) == "no way to the host: no route"


def test_an_error_survives_pickling_to_another_process() -> None:
    plain = RonnaError("no answer", expected="OKAY", action="Try.", wire=b"\x01")
    for error in (plain, CommandRejected(1, "TX"), LinkTimeout("no reply", limit="1 s")):
        again = pickle.loads(pickle.dumps(error))
        assert (type(again), str(again), vars(again)) == (type(error), str(error), vars(error))


@pytest.mark.parametrize(
    ("value", "limit", "decimals", "shown"),
    [
        (0.1504, 0.15, 2, "0.1504"),
        (0.31, 0.3, 2, "0.31"),
        (7.96, 8.0, 1, "7.96"),
        (0.12341, 0.1234, 3, "0.12341"),
        (2.0, 2.0, 2, "2.00"),
    ],
)
def test_a_figure_is_rounded_so_that_it_differs_from_the_limit_it_exceeds(
    value: float, limit: float, decimals: int, shown: str
) -> None:
    assert format_against_limit(value, limit, decimals) == shown


@given(st.floats(0.01, 1000.0), st.floats(1e-3, 0.2), st.booleans(), st.integers(0, 3))
def test_a_figure_and_a_computed_limit_keep_their_order_when_rounded(
    limit: float, share: float, above: bool, decimals: int
) -> None:
    value = limit * (1.0 + share if above else 1.0 - share)
    shown, refused_from = format_distinct(value, limit, decimals)
    assert (float(shown) > float(refused_from)) == above
    assert float(shown) != float(refused_from)


def test_errors_outside_ronna_hw_live_in_an_errors_module_of_their_package() -> None:
    for error in list_errors_with_code():
        if not error.module.startswith("ronna_hw."):
            assert error.module.endswith(".errors"), error
