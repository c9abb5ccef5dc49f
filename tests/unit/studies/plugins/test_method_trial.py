"""The trial of a user method: what it is, what it returns and what it raises is checked for its kind."""

from __future__ import annotations

import sys
from pathlib import Path

import pytest

from procedures.strategies.fixed_orientation import OrientationCorrection
from studies.errors import MethodAnswerWrong, MethodFailed, MethodRefused
from studies.plugin_trial import try_in_subprocess, try_plugin
from studies.plugins.contracts import MethodKind
from studies.plugins.method import find_plugin
from studies.plugins.strategy import PluginStrategy

PAIRING, REGISTRATION = MethodKind.PAIRING, MethodKind.REGISTRATION
LOCALIZER, STRATEGY = MethodKind.LOCALIZER, MethodKind.STRATEGY


@pytest.mark.parametrize(
    ("kind", "text", "said"),
    [
        (PAIRING, "mine:two_points", r"called as a pairing: .*sigma_image_mm.* got \(image_mm, phys"),
        (PAIRING, "mine:stays", r"cannot be called as a pairing: .*\(image_mm, physical_mm, \*, sigma_image"),
        (REGISTRATION, "mine:in_order", "cannot be called as a registration: "),
        (LOCALIZER, "mine:stays", r"cannot be called as a localizer: .* expected a function \(volume\)"),
        (STRATEGY, "mine:nothing", r"cannot be called as a strategy: .* expected a class \(\)"),
        (PAIRING, "mine:in_ordr", r"mine\.py has no 'in_ordr'; expected in_order"),
        (PAIRING, "mine:number", "mine:number is not a pairing; expected a function .* got int"),
        (PAIRING, "theirs:pair", r"theirs of the pairing cannot be imported; .* ModuleNotFoundError"),
        (PAIRING, "mine:", "'mine:' does not name a pairing; expected module:function"),
        (PAIRING, "mine", "there is no pairing 'mine'; expected module:function"),
        (PAIRING, "mine:remembers", "returns different results for the same input"),
        (STRATEGY, "mine:Undecided", "make a strategy; expected localizes_per_trajectory, True or False"),
        (STRATEGY, "mine:Shorter", r"make a strategy; expected turns_rad\(along, fiducials_mm, robot_f"),
    ],
)
def test_an_object_that_is_not_a_method_of_the_kind_is_refused(
    kind: MethodKind, text: str, said: str
) -> None:
    with pytest.raises(MethodRefused, match=f"STU-012: .*{said}"):
        try_plugin(kind, text)


def test_a_module_that_fails_to_import_is_refused(folder: Path) -> None:
    (folder / "half.py").write_text("import nowhere_at_all\n")
    with pytest.raises(MethodRefused, match=r"half of the pairing cannot be imported; .*nowhere_at_all"):
        find_plugin(PAIRING, "half:pair")


@pytest.mark.parametrize(
    ("kind", "text", "said"),
    [
        (PAIRING, "mine:not_whole", r"not return a pairing; expected None, or whole .*\(k, 2\).* of float64"),
        (PAIRING, "mine:twice", "got a point in two pairs"),
        (PAIRING, "mine:beyond", "got index 99 of 5 points"),
        (PAIRING, "mine:uneven", "did not return a pairing"),
        (REGISTRATION, "mine:mirror", "did not return a rigid transform; .* got a mirror image"),
        (REGISTRATION, "mine:larger", "got axes off by 0.2"),
        (REGISTRATION, "mine:only_turn", r"got shape \(3, 3\)"),
        (REGISTRATION, "mine:inverted", r"expected physical <- image, mm, got its inverse fits"),
        (REGISTRATION, "mine:in_metres", r"got it fits with the translation × 1000: metres"),
        (REGISTRATION, "mine:lost", "got numbers that are not finite"),
        (REGISTRATION, "mine:strings", "did not return a rigid transform; .* got text"),
        (REGISTRATION, "mine:imaginary", "did not return a rigid transform; .* got complex numbers"),
        (LOCALIZER, "mine:words", "did not return centres; .* got text"),
        (LOCALIZER, "mine:indices", r"got \(500.0, 20.0, 30.0\), which is outside the volume"),
        (LOCALIZER, "mine:flat", r"did not return centres; .* got shape \(2,\)"),
        (LOCALIZER, "mine:nothing", "did not return centres; .* got NoneType"),
        (STRATEGY, "mine:Beside", "localization_poses returned a wrong result; expected the tool's origin"),
        (STRATEGY, "mine:Once", "localized_along returned a wrong result; expected 10 Trajectory, got 1 of"),
        (STRATEGY, "mine:Still", "turns_rad returned a wrong result; expected at least one finite angle"),
        (STRATEGY, "mine:Endless", "turns_rad returned a wrong result; expected angles within ±2π rad"),
        (STRATEGY, "mine:Degrees", r"turns_rad .* expected angles within ±2π rad, got 90: degrees\?"),
    ],
)
def test_a_result_of_the_wrong_kind_is_refused(kind: MethodKind, text: str, said: str) -> None:
    with pytest.raises(MethodAnswerWrong, match=f"STU-014: .*{said}"):
        try_plugin(kind, text)


@pytest.mark.parametrize(
    ("kind", "text", "said"),
    [
        (PAIRING, "mine:looks_up", r"mine:looks_up raised KeyError: 'nothing': .*mine\.py, line 29"),
        (PAIRING, "mine:writes", r"raised ValueError: .*read-only.*mine\.py, line 32"),
        (PAIRING, "mine:leaves", r"raised SystemExit: 3: .*mine\.py, line 39"),
        (STRATEGY, "mine:Later", r"Later.turns_rad raised ZeroDivisionError"),  # in a generator
        (STRATEGY, "mine:Moody", r"Moody.controls_approach raised .*mine\.py, line"),  # in a property
    ],
)
def test_an_exception_in_a_method_is_reported_with_its_line(kind: MethodKind, text: str, said: str) -> None:
    with pytest.raises(MethodFailed, match=f"STU-013: .*{said}"):
        try_plugin(kind, text)


def test_a_property_that_fails_later_is_reported() -> None:
    class Tires(OrientationCorrection):
        looks = 0

        def __getattribute__(self, name: str) -> object:
            if name == "controls_approach":
                raise OSError("tired")
            return super().__getattribute__(name)

    with pytest.raises(MethodFailed, match=r"STU-013: tires.controls_approach raised OSError: tired"):
        _ = PluginStrategy("tires", Tires()).controls_approach


def test_a_method_that_exits_its_process_is_reported_by_the_trial(folder: Path) -> None:
    (folder / "gone.py").write_text("import os\ndef gone(image_mm, physical_mm, **given):\n    os._exit(0)\n")
    with pytest.raises(MethodFailed, match=r"STU-013: gone:gone ended its process: os\._exit, .* tried"):
        try_in_subprocess(PAIRING, "gone:gone")


def test_an_installed_method_is_found_by_its_name_for_its_own_kind_only(folder: Path) -> None:
    information = folder / "my_methods-0.1.dist-info"
    information.mkdir()
    (information / "METADATA").write_text("Metadata-Version: 2.1\nName: my-methods\nVersion: 0.1\n")
    (information / "entry_points.txt").write_text("[ronna_hw.registrations]\nstaying = mine:stays\n")
    sys.path.append(str(folder))
    assert try_plugin(REGISTRATION, "staying").reference == "mine:stays"
    with pytest.raises(MethodRefused, match="'staying' is the name of a registration; expected a pairing"):
        try_plugin(PAIRING, "staying")


@pytest.mark.slow
def test_our_localizer_and_strategy_pass_the_trial_as_user_methods(folder: Path) -> None:
    (folder / "ours.py").write_text(
        "from procedures.imaging import localize\n"
        "from procedures.strategies.fixed_orientation import NeutralOrientation\n"
        "def centres(volume):\n"
        "    return localize(volume).centres_mm\n"
    )
    assert try_plugin(LOCALIZER, "ours:centres").name == "ours:centres"
    assert try_plugin(STRATEGY, "ours:NeutralOrientation").name == "ours:NeutralOrientation"
