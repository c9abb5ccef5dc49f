"""One mechanism suggests what a mistyped name was meant to be."""

from __future__ import annotations

import re
from pathlib import Path

import pytest
from user_commands import in_this_process

from conformance.cli import app as conformance
from procedures.cli.procedure import app as procedure
from ronna_hw.near_names import did_you_mean, find_near
from sim.cli import app as simulators

ROOT = Path(__file__).parents[3]
PACKAGES = ("ronna_hw", "drivers", "sim", "conformance", "procedures", "studies", "console")


def test_the_nearest_known_name_is_suggested_whatever_its_case_and_a_far_one_is_not() -> None:
    assert find_near("OCs", ("nos", "ocs", "thesis-ocs")) == ["ocs"]
    assert did_you_mean("trakcer", ("tracker", "stereo")) == "Did you mean tracker?"
    assert did_you_mean("x" * 10_000, ("tracker", "stereo")) == ""


def test_no_other_module_compares_names() -> None:
    users = [
        path.relative_to(ROOT).as_posix()
        for package in PACKAGES
        for path in (ROOT / package).rglob("*.py")
        if re.search(r"\bget_close_matches\b", path.read_text())
    ]
    assert users == ["ronna_hw/near_names.py"]


@pytest.mark.parametrize(
    ("app", "line", "meant"),
    [
        (procedure, "run --sim --scen mini", "--scene"),
        (procedure, "run --sim --scene minni", "mini"),
        (procedure, "run --sim --strategy oc", "ocs"),
        (procedure, "run --sim --arm ur5ee", "ur5e"),
        (procedure, "run --sim --matcher thesi", "thesis"),
        (procedure, "steps --log-level trackr=debug", "tracker"),
        (procedure, "steps --log-level debgu", "debug"),
        (simulators, "phantom --out OUT --scene defult", "default"),
        (simulators, "phantom --out OUT --family plane", "plain"),
        (simulators, "phantom --out OUT --kernel smoth", "smooth"),
        (simulators, "phantom --out OUT --family plain --protocol goood", "good"),
        (conformance, "trackr --sim", "tracker"),
    ],
)
def test_a_word_of_a_command_that_is_nearly_right_is_suggested(
    app: object, line: str, meant: str, tmp_path: Path
) -> None:
    said = in_this_process(app, *line.replace("OUT", str(tmp_path / "out")).split()).stderr
    assert re.search(rf"Did you mean .*{re.escape(meant)}\b", said), said


@pytest.mark.parametrize(
    ("text", "meant"),
    [
        ('[answers]\naproach = "no"\n', "approach"),
        ('[answers]\napproach = "yess"\n', "yes"),
        ('defalt = "first"\n', "default"),
        ('default = "frist"\n', "first"),
    ],
)
def test_a_key_or_value_of_a_file_that_is_nearly_right_is_suggested(
    text: str, meant: str, tmp_path: Path
) -> None:
    file = tmp_path / "answers.toml"
    file.write_text(text)
    said = in_this_process(procedure, "run", "--sim", "--answers", file, "--out", tmp_path / "out").stderr
    assert f"(did you mean '{meant}'?)" in said
