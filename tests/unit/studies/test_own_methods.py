"""User methods in a campaign: each kind is checked at the boundary, with the same numbers on any workers."""

from __future__ import annotations

import sys
from collections.abc import Iterator
from multiprocessing import active_children
from pathlib import Path

import pytest

from procedures.strategies.ocs import OrientationCorrection
from procedures.studies.campaign.ledger import Ledger
from procedures.studies.campaign.silence import Silence
from procedures.studies.campaign.unit import Sums, add_up
from procedures.studies.campaign.workers import run_study
from procedures.studies.correspondence.study import CorrespondenceStudy
from procedures.studies.errors import MethodAnswerWrong, MethodFailed, MethodRefused, OtherStudy
from procedures.studies.heads import NoiseReading
from procedures.studies.own.beside import modules_beside
from procedures.studies.own.contracts import MethodKind
from procedures.studies.own.method import OwnMethod, own_method
from procedures.studies.own.strategy import OwnStrategy
from procedures.studies.own.trial import tried, tried_apart
from procedures.studies.registration import RegistrationStudy

METHODS = '''
import numpy as np
from scipy.spatial.transform import RigidTransform
from procedures.registration.point_registration import register
from procedures.strategies.ocs import OrientationCorrection

drawn = []

def in_order(image_mm, physical_mm, *, sigma_image_mm, sigma_physical_mm):
    """By a random order of NumPy's global numbers."""
    return [(i, i) for i in np.random.permutation(min(len(image_mm), len(physical_mm)))[:3]]

def two_points(image_mm, physical_mm):
    return []

def not_whole(image_mm, physical_mm, **given):
    return np.zeros((3, 2))

def twice(image_mm, physical_mm, **given):
    return [(0, 1), (0, 2), (1, 3)]

def beyond(image_mm, physical_mm, **given):
    return [(0, 0), (1, 1), (2, 99)]

def uneven(image_mm, physical_mm, **given):
    return [(0, 0), (1,)]

def looks_up(image_mm, physical_mm, **given):
    return {}["nothing"]

def writes(image_mm, physical_mm, **given):
    image_mm -= image_mm.mean(axis=0)

def remembers(image_mm, physical_mm, **given):
    drawn.append(1)
    return [(0, len(drawn) % 2)]

def leaves(image_mm, physical_mm, **given):
    raise SystemExit(3)

def stays(image_mm, physical_mm, *, covariance_mm2):
    return np.eye(4)

def mirror(image_mm, physical_mm, *, covariance_mm2):
    return np.diag([1.0, 1.0, -1.0, 1.0])

def larger(image_mm, physical_mm, *, covariance_mm2):
    return np.diag([1.1, 1.1, 1.1, 1.0])

def only_turn(image_mm, physical_mm, *, covariance_mm2):
    return np.eye(3)

def inverted(image_mm, physical_mm, *, covariance_mm2):
    return register(image_mm, physical_mm).transform.inv()

def in_metres(image_mm, physical_mm, *, covariance_mm2):
    matrix = register(image_mm, physical_mm).transform.as_matrix()
    matrix[:3, 3] /= 1000.0
    return matrix

def lost(image_mm, physical_mm, *, covariance_mm2):
    return np.full((4, 4), np.nan)

def indices(volume):
    return [[500.0, 20.0, 30.0]]

def flat(volume):
    return [1.0, 2.0]

def nothing(volume):
    return None

class Beside(OrientationCorrection):
    def localization_poses(self, along, fiducials_mm, robot_from_ct, arm):
        return super().localization_poses(along, np.asarray(fiducials_mm) + 5.0, robot_from_ct, arm)

class Once(OrientationCorrection):
    def localized_along(self, trajectories, fiducials_mm, robot_from_ct):
        return trajectories[:1]

class Still(OrientationCorrection):
    def turns_rad(self, along, fiducials_mm, robot_from_ct, arm):
        return []

class Endless(OrientationCorrection):
    def turns_rad(self, along, fiducials_mm, robot_from_ct, arm):
        return [10**400]

class Degrees(OrientationCorrection):
    def turns_rad(self, along, fiducials_mm, robot_from_ct, arm):
        return [0, 90, 180]

class Later(OrientationCorrection):
    def turns_rad(self, along, fiducials_mm, robot_from_ct, arm):
        return (1 / turn for turn in range(3))

class Moody(OrientationCorrection):
    @property
    def controls_approach(self):
        return {}["nothing"]

    @controls_approach.setter
    def controls_approach(self, value):
        pass

class Undecided:
    localizes_per_trajectory = "always"

class Shorter(OrientationCorrection):
    def turns_rad(self, along):
        return [0.0]

number = 3
'''
PAIRING, REGISTRATION = MethodKind.PAIRING, MethodKind.REGISTRATION
LOCALIZER, STRATEGY = MethodKind.LOCALIZER, MethodKind.STRATEGY


@pytest.fixture(autouse=True)
def folder(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Iterator[Path]:
    """The current folder, with the methods in a module."""
    (tmp_path / "mine.py").write_text(METHODS)
    monkeypatch.chdir(tmp_path)
    monkeypatch.setattr(sys, "path", [*sys.path])
    sys.modules.pop("mine", None)
    yield tmp_path
    sys.modules.pop("mine", None)


@pytest.mark.parametrize(
    ("kind", "text", "said"),
    [
        (
            PAIRING,
            "mine:two_points",
            r"called as a pairing: .*sigma_image_mm.* got \(image_mm, phys",
        ),
        (PAIRING, "mine:stays", r"cannot be called as a pairing: .*\(image_mm, physical_mm, \*, sigma_image"),
        (REGISTRATION, "mine:in_order", "cannot be called as a registration: "),
        (LOCALIZER, "mine:stays", r"cannot be called as a localizer: .* expected a function \(volume\)"),
        (STRATEGY, "mine:nothing", r"cannot be called as a strategy: .* expected a class \(\)"),
        (PAIRING, "mine:in_ordr", r"mine\.py has no 'in_ordr'; expected in_order"),
        (PAIRING, "mine:number", "mine:number is not a pairing; expected a function .* got int"),
        (
            PAIRING,
            "theirs:pair",
            r"theirs of the pairing cannot be imported; .* ModuleNotFoundError",
        ),
        (PAIRING, "mine:", "'mine:' does not name a pairing; expected module:function"),
        (PAIRING, "mine", "there is no pairing 'mine'; expected module:function"),
        (PAIRING, "mine:remembers", "returns different results for the same input"),
        (
            STRATEGY,
            "mine:Undecided",
            "does not make a strategy; expected localizes_per_trajectory, True or False",
        ),
        (
            STRATEGY,
            "mine:Shorter",
            r"make a strategy; expected turns_rad\(along, fiducials_mm, robot_from_ct",
        ),
    ],
)
def test_an_object_that_is_not_a_method_of_the_kind_is_refused(
    kind: MethodKind, text: str, said: str
) -> None:
    with pytest.raises(MethodRefused, match=f"STU-012: .*{said}"):
        tried(kind, text)


def test_a_module_that_fails_to_import_is_refused(folder: Path) -> None:
    (folder / "half.py").write_text("import nowhere_at_all\n")
    with pytest.raises(MethodRefused, match=r"half of the pairing cannot be imported; .*nowhere_at_all"):
        own_method(PAIRING, "half:pair")


@pytest.mark.parametrize(
    ("kind", "text", "said"),
    [
        (
            PAIRING,
            "mine:not_whole",
            r"did not return a pairing; expected None, or whole numbers \(k, 2\).* of float64",
        ),
        (PAIRING, "mine:twice", "got a point in two pairs"),
        (PAIRING, "mine:beyond", "got index 99 of 5 points"),
        (PAIRING, "mine:uneven", "did not return a pairing"),
        (REGISTRATION, "mine:mirror", "did not return a rigid transform; .* got a mirror image"),
        (REGISTRATION, "mine:larger", "got axes off by 0.2"),
        (REGISTRATION, "mine:only_turn", r"got shape \(3, 3\)"),
        (REGISTRATION, "mine:inverted", r"expected physical <- image, mm, got its inverse fits"),
        (REGISTRATION, "mine:in_metres", r"got it fits with the translation × 1000: metres"),
        (REGISTRATION, "mine:lost", "got numbers that are not finite"),
        (
            LOCALIZER,
            "mine:indices",
            r"got \(500.0, 20.0, 30.0\), which is outside the volume",
        ),
        (LOCALIZER, "mine:flat", r"did not return centres; .* got shape \(2,\)"),
        (LOCALIZER, "mine:nothing", r"did not return centres; .* got shape \(\)"),
        (
            STRATEGY,
            "mine:Beside",
            r"localization_poses returned a wrong result; expected the tool's origin at each",
        ),
        (
            STRATEGY,
            "mine:Once",
            "localized_along returned a wrong result; expected 10 Trajectory, got 1 of",
        ),
        (
            STRATEGY,
            "mine:Still",
            "turns_rad returned a wrong result; expected at least one finite angle",
        ),
        (STRATEGY, "mine:Endless", "turns_rad returned a wrong result; expected angles within ±2π rad"),
        (STRATEGY, "mine:Degrees", r"turns_rad .* expected angles within ±2π rad, got 90: degrees\?"),
    ],
)
def test_a_result_of_the_wrong_kind_is_refused(kind: MethodKind, text: str, said: str) -> None:
    with pytest.raises(MethodAnswerWrong, match=f"STU-014: .*{said}"):
        tried(kind, text)


@pytest.mark.parametrize(
    ("text", "said"),
    [
        ("mine:looks_up", r"mine:looks_up raised KeyError: 'nothing': .*mine\.py, line 29"),
        ("mine:writes", r"raised ValueError: .*read-only.*mine\.py, line 32"),
        ("mine:leaves", r"raised SystemExit: 3: .*mine\.py, line 39"),
    ],
)
def test_an_exception_in_a_method_is_reported_with_its_line(text: str, said: str) -> None:
    with pytest.raises(MethodFailed, match=f"STU-013: .*{said}"):
        tried(PAIRING, text)


def test_an_exception_in_a_generator_is_reported_when_it_is_consumed() -> None:
    with pytest.raises(MethodFailed, match=r"STU-013: .*Later.turns_rad raised ZeroDivisionError"):
        tried(STRATEGY, "mine:Later")


def test_an_exception_in_a_property_is_reported_with_its_line() -> None:
    with pytest.raises(MethodFailed, match=r"STU-013: .*Moody.controls_approach raised .*mine\.py, line"):
        tried(STRATEGY, "mine:Moody")


def test_a_property_that_fails_later_is_reported() -> None:
    class Tires(OrientationCorrection):
        looks = 0

        def __getattribute__(self, name: str) -> object:
            if name == "controls_approach":
                raise OSError("tired")
            return super().__getattribute__(name)

    with pytest.raises(MethodFailed, match=r"STU-013: tires.controls_approach raised OSError: tired"):
        _ = OwnStrategy("tires", Tires()).controls_approach


def study_of(method: OwnMethod) -> CorrespondenceStudy:
    return CorrespondenceStudy(3, 5, (), readings=(NoiseReading.NORM,), fiducials=(4,), own=(method,))


def results(study: CorrespondenceStudy, folder: Path, **where: object) -> dict[str, Sums]:
    ledger = Ledger(folder, study)
    run_study(study, ledger, **where)
    return add_up(ledger.results())


def test_random_numbers_of_a_method_do_not_depend_on_its_worker(folder: Path) -> None:
    study = study_of(tried(PAIRING, "mine:in_order"))
    assert results(study, folder / "1", workers=1) == results(study, folder / "2", workers=2)


@pytest.mark.slow
def test_a_user_file_runs_on_dask_workers_in_another_folder(
    folder: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    from distributed import LocalCluster

    study = study_of(tried(PAIRING, "mine:in_order"))
    here = results(study, folder / "here", workers=1)
    elsewhere = folder / "elsewhere"
    elsewhere.mkdir()
    monkeypatch.chdir(elsewhere)  # the workers cannot find the file by themselves
    monkeypatch.setattr(sys, "path", [one for one in sys.path if one != str(folder)])
    with LocalCluster(
        n_workers=2, threads_per_worker=1, dashboard_address="127.0.0.1:0", host="127.0.0.1"
    ) as cluster:
        assert results(study, folder / "dask", scheduler=cluster.scheduler_address) == here


def test_an_edited_method_is_another_study_and_its_old_version_does_not_run(folder: Path) -> None:
    before = tried(PAIRING, "mine:in_order")
    Ledger(folder / "out", study_of(before))
    (folder / "mine.py").write_text(METHODS.replace("[:3]", "[:4]"))
    with pytest.raises(MethodRefused, match="STU-012: mine:in_order is a different version here"):
        before.function()
    after = tried(PAIRING, "mine:in_order")
    with pytest.raises(OtherStudy, match=r"STU-001: .*own"):
        Ledger(folder / "out", study_of(after))


LAZY = """
def pair(image_mm, physical_mm, **given):
    from helping.pairs import first
    return first
"""


def test_local_imports_of_a_method_are_part_of_its_version(folder: Path) -> None:
    (folder / "lazy.py").write_text(LAZY)
    (folder / "stranger.py").write_text("")
    (folder / "helping").mkdir()
    (folder / "helping" / "__init__.py").write_text("from helping import pairs\n")
    pairs = folder / "helping" / "pairs.py"
    pairs.write_text("import numpy\nfirst = [(0, 0)]\n")
    before = own_method(PAIRING, "lazy:pair")
    assert set(modules_beside(sys.modules["lazy"])) == {"lazy", "helping", "helping.pairs"}
    assert before.function()(None, None) == [(0, 0)]
    pairs.write_text("import numpy\nfirst = [(0, 0), (1, 1)]\n")
    with pytest.raises(MethodRefused, match="STU-012: lazy:pair is a different version here"):
        before.function()
    after = own_method(PAIRING, "lazy:pair")
    assert after.sha256 != before.sha256
    assert after.function()(None, None) == [(0, 0), (1, 1)]


def test_a_failure_during_a_run_names_the_method_and_the_unit(folder: Path) -> None:
    late = "def late(image_mm, physical_mm, **given):\n    return [] if len(image_mm) == 5 else 1 / 0\n"
    (folder / "late.py").write_text(late)
    study = study_of(tried(PAIRING, "late:late"))
    with pytest.raises(MethodFailed, match=r"late raised ZeroDivisionError: .*, in unit norm\|1\|4\|0 #0: "):
        results(study, folder / "out", workers=1)


def test_a_method_that_exits_its_process_is_reported_by_the_trial(folder: Path) -> None:
    (folder / "gone.py").write_text("import os\ndef gone(image_mm, physical_mm, **given):\n    os._exit(0)\n")
    with pytest.raises(MethodFailed, match=r"STU-013: gone:gone ended its process: os\._exit, .* tried"):
        tried_apart(PAIRING, "gone:gone")


def test_a_method_that_exits_during_a_run_is_reported_with_its_unit_and_finished_units_are_kept(
    folder: Path,
) -> None:
    gone = "import os\ndef gone(image_mm, physical_mm, **given):\n    return [] if %s else os._exit(0)\n"
    (folder / "gone.py").write_text(gone % "len(physical_mm) < 6")
    study = study_of(own_method(PAIRING, "gone:gone"))
    ledger = Ledger(folder / "out", study)
    with pytest.raises(MethodFailed, match=r"STU-013: gone:gone ended its process: .*, in norm\|1\|4\|2 #0"):
        run_study(study, ledger, workers=1)
    assert [*Ledger(folder / "out", study).finished] == ["norm|1|4|0 #0", "norm|1|4|1 #0"]


def test_a_hanging_method_is_reported_once_and_ends_with_the_campaign(
    folder: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    (folder / "loops.py").write_text("def loops(image_mm, physical_mm, **given):\n    while True: pass\n")
    study = study_of(own_method(PAIRING, "loops:loops"))
    monkeypatch.setattr(Silence.__init__, "__defaults__", (0.1,))
    told = []

    def interrupt_after_the_first(text: str) -> None:
        told.append(text)
        raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        run_study(study, Ledger(folder / "out", study), workers=1, tell=interrupt_after_the_first)
    assert told == ["loops:loops has not answered for 0.1 s, in norm|1|4|0 #0; Ctrl-C stops it"]
    assert not active_children()


def test_an_installed_method_is_found_by_its_name_for_its_own_kind_only(folder: Path) -> None:
    information = folder / "my_methods-0.1.dist-info"
    information.mkdir()
    (information / "METADATA").write_text("Metadata-Version: 2.1\nName: my-methods\nVersion: 0.1\n")
    (information / "entry_points.txt").write_text("[ronna_hw.registrations]\nstaying = mine:stays\n")
    sys.path.append(str(folder))
    assert tried(REGISTRATION, "staying").reference == "mine:stays"
    with pytest.raises(MethodRefused, match="'staying' is the name of a registration; expected a pairing"):
        tried(PAIRING, "staying")


def test_a_user_registration_is_measured_on_the_same_points_as_ours(folder: Path) -> None:
    (folder / "same.py").write_text(
        "from procedures.registration.point_registration import register\n"
        "def same(image_mm, physical_mm, *, covariance_mm2):\n"
        "    return register(image_mm, physical_mm).transform\n"
    )
    study = RegistrationStudy(2, fiducials=(4,), own=(tried(REGISTRATION, "same:same"),))
    sums = study.run(study.units()[0])
    assert sums["own same:same2"] == sums["tre2"]


def test_our_localizer_and_strategy_pass_the_trial_as_user_methods(folder: Path) -> None:
    (folder / "ours.py").write_text(
        "from procedures.imaging import localize\n"
        "from procedures.strategies.nos import NeutralOrientation\n"
        "def centres(volume):\n"
        "    return localize(volume).centres_mm\n"
    )
    assert tried(LOCALIZER, "ours:centres").name == "ours:centres"
    assert tried(STRATEGY, "ours:NeutralOrientation").name == "ours:NeutralOrientation"
