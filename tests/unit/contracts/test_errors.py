import importlib
import pkgutil
import re
from pathlib import Path

import drivers
import procedures
import ronna_hw
import sim
from ronna_hw.errors import RonnaError, concrete_errors

PACKAGES = (ronna_hw, drivers, sim, procedures)
TESTS = Path(__file__).resolve().parents[2]


def _our_errors() -> list[type[RonnaError]]:
    """Every error with a code in our packages; tests define errors of their own."""
    for package in PACKAGES:
        for module in pkgutil.walk_packages(package.__path__, package.__name__ + "."):
            if module.name.endswith("errors") or package is ronna_hw:
                importlib.import_module(module.name)
    ours = {package.__name__ for package in PACKAGES}
    return [error for error in concrete_errors() if error.__module__.partition(".")[0] in ours]


def test_every_code_is_given_once_and_every_error_says_what_to_do() -> None:
    seen: dict[str, str] = {}
    for error in _our_errors():
        assert re.fullmatch(r"[A-Z]{2,5}-\d{3}", error.code), error
        assert error.action, error
        assert error.code not in seen, f"{error.code} is {error.__name__} and {seen[error.code]}"
        seen[error.code] = error.__name__
    assert len(seen) > 20


def test_every_code_is_named_by_a_test() -> None:
    tests = "\n".join(path.read_text(encoding="utf-8") for path in TESTS.rglob("*.py"))
    words = set(re.findall(r"\w+(?:-\d{3})?", tests))
    assert [error for error in _our_errors() if not words & {error.code, error.__name__}] == []


def test_an_error_is_one_line_with_what_was_expected_the_limit_and_what_to_do() -> None:
    error = RonnaError(
        "no answer", expected="OKAY", limit="2 s", got="nothing", action="Try.", wire=b"\x01\xff"
    )
    assert str(error) == "no answer; expected OKAY, limit 2 s, got nothing; last bytes 01 ff. Try."


def test_a_value_without_anything_to_compare_it_with_follows_a_colon() -> None:
    assert (
        str(RonnaError("no way to 10.0.0.1", got="no route to host"))
        == "no way to 10.0.0.1: no route to host"
    )


def test_outside_the_contracts_errors_live_in_their_packages_errors_module() -> None:
    for error in _our_errors():
        if not error.__module__.startswith("ronna_hw."):
            assert error.__module__.endswith(".errors"), error
