"""A scan of the skin that was interrupted goes on with the looks that are missing."""

from __future__ import annotations

import itertools
from types import SimpleNamespace
from typing import Any, cast

import numpy as np
import pytest
from coded_errors import raises

from procedures.engine.context import StepContext
from procedures.engine.events import ScanProgress
from procedures.journal.journal import Entry, Line
from procedures.registration.surface.errors import NOTHING_LIT
from procedures.registration.surface.surface import Surface
from procedures.relocalization.errors import Saturated
from procedures.steps.clinical.path_check import CheckedPaths
from procedures.steps.clinical.results import ScannedLine, ScannedLook
from procedures.steps.clinical.surface import surface_scan, surface_survey
from procedures.steps.clinical.surface.look_scanner import (
    FEWEST_DARK,
    has_gone_out,
    require_line_to_the_end,
    require_lines,
)
from procedures.steps.clinical.surface.scan_coverage import ScanCoverage, describe_scan
from procedures.workcell.arm_history import ArmHistory
from procedures.workcell.workcell import Workcell
from ronna_hw.arm.errors import NotClear
from ronna_hw.frames import Frame, Transform

LOOKS, DARK = 5, 1  # number of the look that shows no line
POSE = Transform.of(Frame.ROBOT, Frame.CT)


class Skin:
    """Flat skin of a hand's size."""

    points_mm = np.stack(
        [*np.meshgrid(np.arange(0.0, 100.0, 4.0), np.arange(0.0, 40.0, 4.0)), np.zeros((10, 25))], -1
    )
    points_mm = points_mm.reshape(-1, 3)
    normals = np.tile([0.0, 0.0, 1.0], (len(points_mm), 1))


class Dome:
    """Upper half of an ellipsoid, which determines a pose."""

    def __init__(self) -> None:
        turn, height = (
            one.ravel() for one in np.meshgrid(np.arange(0.0, 6.28, 0.05), np.arange(0.05, 1.5, 0.05))
        )
        ball = np.column_stack([np.cos(turn) * np.cos(height), np.sin(turn) * np.cos(height), np.sin(height)])
        axes_mm = np.array([75.0, 95.0, 85.0])
        self.points_mm = ball * axes_mm
        self.normals = ball / axes_mm / np.linalg.norm(ball / axes_mm, axis=1, keepdims=True)


class Cell:
    """The workcell as far as it keeps looks: its lines are read back as after a kill."""

    def __init__(self) -> None:
        self.journal: list[dict[str, Any]] = []
        self.clock = SimpleNamespace(now_s=lambda: 0.0)
        self.master = SimpleNamespace(joints_rad=lambda: (0.0,) * 6)

    def scanned_looks(self, paths: str) -> tuple[Line, ...]:
        return Workcell.scanned_looks(cast(Workcell, self), paths)

    def record_scanned_look(self, paths: str, look: Line | None) -> None:
        Workcell.record_scanned_look(cast(Workcell, self), paths, look)

    @property
    def _log(self) -> Any:
        history = ArmHistory()
        for line in self.journal:
            history = history.with_line(line)
        return SimpleNamespace(history=history, write=self._write)

    def _write(self, entry: Entry, **data: Any) -> None:
        self.journal.append({"entry": entry, **data})


class Interrupted(Exception):
    """Whatever ends a step early."""


class Scan:
    """Scans with looks that are counted."""

    def __init__(self, monkeypatch: pytest.MonkeyPatch) -> None:
        self.cell, self.taken, self.states = Cell(), list[int](), list[ScanProgress]()
        self.paths, self.stops_at, self.count, self.dark = "09-path_check", LOOKS, LOOKS, {DARK}
        monkeypatch.setattr(surface_scan, "skin_of", lambda _context: Skin)
        monkeypatch.setattr(surface_scan, "arriving", lambda *_arguments: None)
        scan = self

        class Scanner:
            reason = code = ""

            def __init__(self, _context: object, number: int, *_others: object) -> None:
                self.number = number

            def scan(self) -> list[ScannedLine]:
                if self.number == scan.stops_at:
                    raise Interrupted
                scan.taken.append(self.number)
                return [] if self.number in scan.dark else [line_of(self.number)]

        for step in (surface_scan, surface_survey):
            monkeypatch.setattr(step, "LookScanner", Scanner)
        monkeypatch.setattr(surface_survey, "_as_look", lambda *_arguments: None)
        monkeypatch.setattr(surface_scan, "Centring", lambda *_arguments: None)

    def take(self) -> tuple[ScannedLook, ...]:
        looks = [SimpleNamespace(tool_pose=SimpleNamespace(transform=at(one))) for one in range(self.count)]
        paths = SimpleNamespace(skin_looks=looks)
        trajectory = SimpleNamespace(target_mm=(50.0, 20.0, -60.0))
        result = SimpleNamespace(
            robot_from_ct=SimpleNamespace(transform=POSE), pairs=(), trajectory=lambda _name: trajectory
        )
        context = cast(
            StepContext,
            SimpleNamespace(
                workcell=self.cell,
                setting=SimpleNamespace(settings=SimpleNamespace(approach_mm=50.0)),
                result=lambda _model: result,
                identifier=lambda _model: self.paths,
                served_trajectories=("T1",),
                progress=lambda _share, _text, state: self.states.append(state),
            ),
        )
        kept = [ScannedLook.model_validate(one) for one in self.cell.scanned_looks(self.paths)]
        looks, self.state = surface_scan._take_looks(context, cast(CheckedPaths, paths), kept)
        return looks

    def survey(self, measured: str = "08-head_measurement") -> tuple[ScannedLook, ...]:
        """Take first looks at a measured head."""
        context = SimpleNamespace(
            workcell=self.cell,
            identifier=lambda _model: measured,
            progress=lambda _share, _text: None,
            find=lambda _text: None,
        )
        return surface_survey.take_looks(
            cast(StepContext, context), cast(Any, range(self.count)), cast(Any, None)
        )


def at(number: int) -> Transform:
    return Transform.of(Frame.ROBOT, Frame.TOOL, translation_mm=(10.0 + 20.0 * number, 20.0, 0.0))


def line_of(number: int) -> ScannedLine:
    x = 10.0 + 20.0 * number
    return ScannedLine(
        look=number,
        joints_rad=(0.0,) * 6,
        view_mm=(x, 20.0, 300.0),
        points_mm=tuple((x, float(y), 0.0) for y in range(8, 33, 4)),
        covariances_mm2=((0.01, 0.0, 0.0, 0.01, 0.0, 0.01),) * 7,
    )


@pytest.fixture
def scan(monkeypatch: pytest.MonkeyPatch) -> Scan:
    return Scan(monkeypatch)


@pytest.mark.parametrize("stop", range(LOOKS))
def test_a_scan_interrupted_at_any_look_keeps_those_before_and_takes_the_rest(scan: Scan, stop: int) -> None:
    scan.stops_at = stop
    with pytest.raises(Interrupted):
        scan.take()
    before = list(scan.taken)
    scan.stops_at = LOOKS
    looks = scan.take()
    assert before == list(range(stop))
    again = [DARK] if stop > DARK else []  # it showed no line: the projector may have been off
    assert scan.taken[stop:] == sorted([*again, *range(stop, LOOKS)])
    assert sorted(one.number for one in looks) == list(range(LOOKS))
    assert looks[0].lines == (line_of(0),)


def test_looks_of_another_path_check_are_not_kept(scan: Scan) -> None:
    """After anything moved, the room is localized and the paths are checked again, under another name."""
    scan.stops_at = 3
    with pytest.raises(Interrupted):
        scan.take()
    scan.taken, scan.stops_at, scan.paths = [], LOOKS, "14-path_check"
    scan.take()
    assert scan.taken == list(range(LOOKS))


def test_first_looks_that_were_interrupted_are_kept_until_the_head_is_measured_again(scan: Scan) -> None:
    scan.stops_at = 3
    with pytest.raises(Interrupted):
        scan.survey()
    scan.taken, scan.stops_at = [], LOOKS
    looks = scan.survey()
    assert scan.taken == [DARK, 3, 4]
    assert [one.number for one in looks] == list(range(LOOKS))
    assert looks[0].lines == (line_of(0),)
    scan.taken = []
    scan.survey("10-head_measurement")
    assert scan.taken == list(range(LOOKS))


def test_a_whole_scan_that_is_repeated_takes_every_look_again(scan: Scan) -> None:
    scan.take()
    scan.cell.record_scanned_look(scan.paths, None)
    scan.taken = []
    scan.take()
    assert scan.taken == list(range(LOOKS))


def test_progress_grows_and_goes_on_where_a_scan_was_interrupted(scan: Scan) -> None:
    scan.stops_at = 3
    with pytest.raises(Interrupted):
        scan.take()
    scan.stops_at, interrupted_at = LOOKS, scan.states[-1]
    scan.take()
    done = [one.looks_done for one in scan.states]
    assert done == [0, 1, 2, 3, 2, 3, 4, 5]
    assert interrupted_at.covered_share == scan.states[4].covered_share
    covered = [one.covered_share for one in scan.states[4:]]
    assert covered == sorted(covered)
    assert 0.0 < covered[0] < covered[-1]
    said = describe_scan(scan.states[-1])
    assert f"{covered[-1]:.0%} of the skin around the planned looks lies within 5 mm of a line" in said
    assert scan.states[-1].predicted_error_mm is None  # a plane allows any pose along it


def test_what_is_covered_and_what_is_not_are_the_planned_skin_after_every_look_and_after_an_interruption(
    scan: Scan,
) -> None:
    scan.stops_at = 3
    with pytest.raises(Interrupted):
        scan.take()
    scan.stops_at = LOOKS
    scan.take()
    before, after = scan.states[3], scan.states[4]
    assert before.covered_mm == after.covered_mm != ()
    planned = {frozenset(one.covered_mm + one.missing_mm) for one in scan.states}
    assert len(planned) == 1
    covered = [set(one.covered_mm) for one in scan.states[4:]]
    assert all(less <= more for less, more in itertools.pairwise(covered))
    beyond = 10.0 + 20.0 * DARK  # between the looks beside it, and covered by neither
    assert {x for x, _, _ in scan.state.missing_mm} >= {beyond - 2.0}
    assert scan.state == scan.states[-1]
    assert [(one.target, one.rms_mm) for one in scan.state.expected] == [("T1", (None,) * LOOKS)]


def test_the_error_that_is_expected_at_each_target_falls_look_by_look() -> None:
    dome = Dome()
    looks = dome.points_mm[:: len(dome.points_mm) // 6][:6]
    targets = {"deep": (0.0, 0.0, 0.0), "shallow": (0.0, -60.0, 40.0)}
    coverage = ScanCoverage(cast(Surface, dome), looks, targets)
    for look in looks:
        coverage.add(dome.points_mm[np.linalg.norm(dome.points_mm - look, axis=1) < 12.0])
    state = coverage.after(6)
    assert [one.target for one in state.expected] == list(targets)
    for one in state.expected:
        known = [error for error in one.rms_mm if error is not None]
        assert len(one.rms_mm) == 6
        assert len(known) >= 2
        assert known[-1] < known[0]
    last = [one.rms_mm[-1] for one in state.expected]
    assert state.predicted_error_mm == pytest.approx(np.sqrt(np.mean(np.square(last))))


def test_spheres_beside_the_skin_count_in_the_error_that_is_expected_of_a_scan() -> None:
    dome = Dome()
    looks = dome.points_mm[:: len(dome.points_mm) // 6][:6]
    targets = {"deep": (0.0, 0.0, 0.0), "shallow": (0.0, -60.0, 40.0)}
    screws_mm = np.array([[30.0, -50.0, 70.0], [-40.0, -30.0, 75.0], [5.0, -85.0, 45.0]])

    def expect(count: int) -> float:
        coverage = ScanCoverage(cast(Surface, dome), looks, targets, screws_mm[:count])
        for look in looks:
            coverage.add(dome.points_mm[np.linalg.norm(dome.points_mm - look, axis=1) < 12.0])
        error_mm = coverage.after(6).predicted_error_mm
        assert error_mm is not None
        return error_mm

    by_count = [expect(count) for count in range(4)]
    assert by_count == sorted(by_count, reverse=True)
    assert by_count[3] < 0.75 * by_count[0]


def test_kept_looks_are_lines_of_the_journal() -> None:
    cell = Cell()
    cell.record_scanned_look("09-path_check", {"number": 0})
    assert [line["entry"] for line in cell.journal] == [Entry.SCANNED]


@pytest.mark.parametrize(("take", "taken"), [(Scan.take, 5), (Scan.survey, 7)])
def test_a_projector_that_does_not_light_is_told_before_all_looks_are_taken(
    scan: Scan, take: Any, taken: int
) -> None:
    scan.count = scan.stops_at = 12
    scan.dark = set(range(12))
    looks = take(scan)
    assert len(looks) == taken
    with raises(
        NOTHING_LIT, match=f"none of the first {taken} looks shows the line.*{taken} dark looks of 12"
    ):
        require_lines(looks, 12)


@pytest.mark.branch("DARK_SCAN")
@pytest.mark.parametrize(("lit", "taken"), [(2, 7), (5, 10), (7, 12), (8, 12)])
def test_a_projector_that_goes_out_is_told_while_looks_are_left(scan: Scan, lit: int, taken: int) -> None:
    scan.count = scan.stops_at = 12
    scan.dark = set(range(lit, 12))
    looks = scan.take()
    assert len(looks) == taken
    require_lines(looks, 12)
    if taken - lit < FEWEST_DARK:
        require_line_to_the_end(looks, 12)
        return
    said = "not at the last 5 looks.*5 dark looks of 12 planned.*the projector still lights.*are kept"
    with raises(NOTHING_LIT, match=said):
        require_line_to_the_end(looks, 12)


def test_looks_that_the_arm_cannot_take_say_nothing_of_the_projector() -> None:
    lit, dark = (ScannedLook(number=0, lines=lines, theatre_s=1.0) for lines in ((line_of(0),), ()))
    beside = dark.model_copy(update={"code": NotClear.code})
    assert not has_gone_out([lit, *[dark] * 4, beside])
    assert has_gone_out([lit, *[dark] * 4, beside, dark])
    assert not has_gone_out([lit, *[dark] * 4, lit, dark])
    saturated = dark.model_copy(update={"code": Saturated.code})
    with raises(NOTHING_LIT, match="5 saturated looks of 13 planned.*shorten the exposure.*are kept"):
        require_line_to_the_end([lit, *[saturated] * 5], 13)


def test_first_looks_beside_the_head_do_not_mean_that_the_projector_has_gone_out(scan: Scan) -> None:
    scan.count = scan.stops_at = 12
    scan.dark = set(range(6, 12))
    assert len(scan.survey()) == 12


@pytest.mark.parametrize("take", [Scan.take, Scan.survey])
def test_looks_at_hair_first_do_not_end_a_scan(scan: Scan, take: Any) -> None:
    scan.count = scan.stops_at = 12
    scan.dark = {0, 1, 2, 3}
    assert len(take(scan)) == 12
