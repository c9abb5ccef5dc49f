"""Steps of a case without markers: what they stand in for, and what they refuse."""

from __future__ import annotations

from contextlib import nullcontext
from functools import partial
from types import SimpleNamespace
from typing import Any, cast

import cv2
import numpy as np
import pytest
from coded_errors import raises
from prepared_results import localized_fiducials, plan

from procedures.engine.case import stand_ins
from procedures.engine.context import StepContext
from procedures.engine.methods import CaseMethods, HeadStart
from procedures.imaging.head_landmarks import find_landmark
from procedures.imaging.volume import Volume, VoxelGeometry
from procedures.planning.head_in_ct import HeadEllipsoid
from procedures.planning.plan_model import FiducialKind
from procedures.registration.errors import HeadElsewhere
from procedures.registration.room_prior import HeadSight, RoomPrior
from procedures.registration.surface.errors import (
    ARM_NOT_CALIBRATED,
    FAR_FROM_START,
    HALF_A_HEAD,
    HEAD_MOVED,
    LITTLE_COVERAGE,
    MIRRORED_HEAD,
    MUCH_EXCLUDED,
    NO_PATIENT_FRAME,
    NO_PROJECTOR,
    NO_STATIONS,
    NOTHING_LIT,
    OTHER_HEAD,
    POORLY_DETERMINED,
    SKIN_CHANGED,
    SPHERE_MOVED,
    TWO_POSES,
)
from procedures.registration.surface.starts import Start
from procedures.registration.surface.surface import Surface
from procedures.relocalization.errors import NoLine, PairNotUsable, Saturated
from procedures.relocalization.laser_line import LineImage
from procedures.runs.case import strategy_of
from procedures.runs.request import CaseProcedure
from procedures.runs.request_checks import require_one_change
from procedures.steps.catalogue import clinical_steps
from procedures.steps.clinical.correspondence import Correspondence, MeasuredHead, SurfaceStart
from procedures.steps.clinical.fiducial_localization import LocalizedFiducials
from procedures.steps.clinical.global_localization import GlobalLocalization
from procedures.steps.clinical.results import (
    RegisteredRobot,
    Relocalization,
    ScannedLine,
    ScannedLook,
    ScannedSurface,
)
from procedures.steps.clinical.surface import skin_in_ct, surface_paths, surface_start
from procedures.steps.clinical.surface.head_measurement import BY_TAPE
from procedures.steps.clinical.surface.landmark_reading import (
    BY_POINTER,
    LandmarkReading,
    guess_order,
    place_head,
)
from procedures.steps.clinical.surface.look_scanner import LookScanner, describe_short, require_lines
from procedures.steps.clinical.surface.repeated_work import repeat_if_refused
from procedures.steps.clinical.surface.surface_registration import repeats
from procedures.workcell import line_look, workcell
from procedures.workcell.stereo_look import TRUSTED_BGR, pair_picture
from ronna_hw.arm.errors import NotClear
from ronna_hw.arrays import Array
from ronna_hw.command_line.errors import UsageMistake
from ronna_hw.devices.readings import AreaOfInterest, StereoReading
from ronna_hw.errors import RonnaError
from ronna_hw.roles import TWO_ARMS
from ronna_hw.vectors import Vector3


class Head:
    """A stereo head with a line projector, which only says that it is one."""

    has_projector = True
    projector_on = False

    def set_projector(self, on: bool, timeout_s: float = 5.0) -> None:
        raise AssertionError("nothing is switched before the theatre is known to be fit")


def context_of(**workcell: Any) -> StepContext:
    return cast(StepContext, SimpleNamespace(workcell=SimpleNamespace(**workcell)))


@pytest.mark.parametrize("fiducials", [FiducialKind.SURFACE, FiducialKind.MIXED])
def test_later_steps_read_the_skin_where_they_read_spheres(fiducials: FiducialKind) -> None:
    steps = {step.name: step for step in clinical_steps(fiducials=fiducials)}
    bases = (LocalizedFiducials, Correspondence, Relocalization, RegisteredRobot)
    skin = steps.pop("skin_in_ct")
    assert (LocalizedFiducials in skin.reads) == (fiducials is FiducialKind.MIXED)
    read = {model for step in steps.values() for model in step.reads if issubclass(model, bases)}
    assert {model.kind for model in read} == {
        "skin_in_ct",
        "surface_start",
        "surface_scan",
        "surface_registration",
    }


def test_a_start_by_the_scan_measures_the_head_and_looks_before_later_steps_read_its_pose() -> None:
    steps = clinical_steps(fiducials=FiducialKind.SURFACE, start=HeadStart.SCAN)
    names = [step.name for step in steps]
    first = names.index("head_measurement")
    assert names[first : first + 3] == ["head_measurement", "surface_start", "path_check"]
    survey, *later = steps[first + 1 :]
    assert survey.moves
    assert MeasuredHead in survey.reads
    assert not any(MeasuredHead in step.reads for step in later)
    assert list(stand_ins(Correspondence)) == ["correspondence", "surface_start", "head_measurement"]


def test_a_start_by_the_scan_is_for_the_skin_alone() -> None:
    case = CaseProcedure(methods=CaseMethods(start=HeadStart.SCAN))
    require_one_change(case, FiducialKind.SURFACE)
    with pytest.raises(UsageMistake, match="--start scan and fiducials free cannot be combined"):
        require_one_change(case, plan().fiducials)


def test_without_spheres_no_strategy_looks_at_them_and_with_some_the_chosen_one_does() -> None:
    chosen = CaseProcedure(strategy="jdms")
    for kind, name in ((FiducialKind.SURFACE, "surface"), (FiducialKind.MIXED, "jdms")):
        assert strategy_of(chosen, plan().model_copy(update={"fiducials": kind})).name == name


def test_the_skin_in_the_ct_keeps_the_spheres_that_were_localized(monkeypatch: pytest.MonkeyPatch) -> None:
    spheres = localized_fiducials()
    head = HeadEllipsoid(centre_mm=(0.0, 0.0, 0.0), semi_axes_mm=(80.0, 95.0, 80.0))
    corners_mm = np.array([[80.0, 0.0, 0.0], [-80.0, 0.0, 0.0], [0.0, 95.0, 0.0], [0.0, -95.0, -190.0]])
    skin, volume = SimpleNamespace(points_mm=corners_mm, excluded=()), SimpleNamespace()
    volume.series_instance_uid = spheres.series_instance_uid
    monkeypatch.setattr(skin_in_ct, "skin_of", lambda _context: skin)
    monkeypatch.setattr(skin_in_ct, "volume_of", lambda _context: volume)
    monkeypatch.setattr(skin_in_ct, "fit_cranium_and_face", lambda _skin: (head, head))
    workcell = SimpleNamespace(
        stereo=Head(), patient_frame="on clamp", calibrations=SimpleNamespace(arm=object())
    )
    for step, kept in ((skin_in_ct.STEP, ()), (skin_in_ct.WITH_SPHERES, spheres.markers)):
        context = SimpleNamespace(
            workcell=workcell,
            reads=step.reads,
            result=lambda _model: spheres,
            clinical=SimpleNamespace(methods=CaseMethods()),
        )
        assert skin_in_ct.run(cast(StepContext, context)).result.markers == kept


SCAN, START, TAPE, ROOM = ScannedSurface, SurfaceStart, MeasuredHead, GlobalLocalization
REPEATED = {
    **dict.fromkeys((LITTLE_COVERAGE, POORLY_DETERMINED, OTHER_HEAD, HEAD_MOVED), (SCAN, SCAN)),
    **dict.fromkeys((SKIN_CHANGED, MUCH_EXCLUDED), (SCAN, SCAN)),
    **dict.fromkeys((TWO_POSES, FAR_FROM_START), (START, TAPE)),
    SPHERE_MOVED: (ROOM, ROOM),
    MIRRORED_HEAD: (None, None),  # patient and CT are compared: a new scan does not help
}


@pytest.mark.parametrize("is_measured", [False, True])
@pytest.mark.parametrize("problem", REPEATED, ids=lambda one: one.code)
def test_a_refused_registration_voids_what_has_to_be_done_again(problem, is_measured: bool) -> None:
    gone: list[type] = []
    context = SimpleNamespace(
        stands=lambda _model: is_measured, void_each=lambda model, _: gone.append(model)
    )
    in_step = cast(StepContext, context)
    with raises(problem) as refused, repeat_if_refused(in_step, *repeats(in_step)):
        raise problem("refused", limit="1 mm", got="2 mm")
    assert gone == [one for one in [REPEATED[problem][is_measured]] if one is not None]
    assert refused.value.summary == "refused; limit 1 mm, got 2 mm"
    assert ("resume the run, or go on with the next step" in refused.value.advice) == bool(gone)
    assert refused.value.advice.startswith(problem.action)


def test_an_assistant_and_a_scan_of_the_skin_are_not_combined() -> None:
    with pytest.raises(ValueError, match="replace the same step"):
        clinical_steps(fiducials=FiducialKind.SURFACE, roles=TWO_ARMS)


def test_a_theatre_that_cannot_scan_or_watch_the_head_is_refused_first() -> None:
    with raises(NO_PROJECTOR):
        skin_in_ct.run(context_of(stereo=object(), patient_frame="on clamp", calibrations=None))
    with raises(NO_PATIENT_FRAME):
        skin_in_ct.run(context_of(stereo=Head(), patient_frame=None, calibrations=None))
    with raises(ARM_NOT_CALIBRATED):
        skin_in_ct.run(
            context_of(stereo=Head(), patient_frame="on clamp", calibrations=SimpleNamespace(arm=None))
        )


@pytest.mark.parametrize(("lowest_mm", "is_refused"), [(-165.0, False), (-125.0, True)])
def test_a_ct_that_ends_in_the_middle_of_the_face_is_refused(lowest_mm: float, is_refused: bool) -> None:
    around = np.linspace(0.0, 2.0 * np.pi, 40)
    ring = np.column_stack([75.0 * np.cos(around), 95.0 * np.sin(around)])
    skin = np.vstack([np.column_stack([ring, np.full(40, z)]) for z in np.arange(0.0, lowest_mm - 1.0, -5.0)])
    with raises(HALF_A_HEAD) if is_refused else nullcontext():
        skin_in_ct.require_face(cast(Surface, SimpleNamespace(points_mm=skin)))


@pytest.mark.branch("FEW_LOOKS")
def test_too_few_looks_in_reach_are_refused(monkeypatch: pytest.MonkeyPatch) -> None:
    skin = SimpleNamespace(points_mm=np.zeros((4, 3)), normals=np.zeros((4, 3)))
    kinematics = SimpleNamespace(branch_of=lambda _joints: None)
    plan = SimpleNamespace(plan=SimpleNamespace(trajectories=()), carried=None)
    context = SimpleNamespace(result=lambda _model: plan, progress=lambda _share, _text: None)
    monkeypatch.setattr(surface_paths, "skin_of", lambda _context: skin)
    monkeypatch.setattr(
        surface_paths,
        "arm_setting_of",
        lambda _context: SimpleNamespace(kinematics=kinematics, start_rad=()),
    )
    monkeypatch.setattr(surface_paths, "mark_scannable", lambda skin: np.ones(len(skin.points_mm), bool))
    monkeypatch.setattr(surface_paths, "choose_views", lambda *_arguments: ())
    with raises(NO_STATIONS):
        surface_paths.run(cast(StepContext, context))


def test_a_scan_ends_at_a_look_with_much_skin_around_it() -> None:
    middles = np.array([[0.0, 0.0, 0.0], [100.0, 0.0, 0.0], [200.0, 0.0, 0.0]])
    skin = np.repeat(middles, (1, 9, 10), axis=0)
    assert surface_paths.may_close(middles, skin) == [False, True, True]


@pytest.mark.parametrize(("length_mm", "is_told"), [(6.0, True), (22.0, False)])
def test_lines_that_something_hides_in_part_are_told(length_mm: float, is_told: bool) -> None:
    line = ScannedLine(
        look=0,
        joints_rad=(0.0,) * 6,
        view_mm=(0.0, 0.0, 0.0),
        points_mm=[(0.0, 0.0, 0.0), (length_mm, 0.0, 0.0)],
        covariances_mm2=[(0.01, 0.0, 0.0, 0.01, 0.0, 0.01)] * 2,
    )
    told = describe_short([line] * 3)
    assert (told is not None and "less than 6 mm" in told) is is_told


@pytest.mark.branch("DARK_SCAN")
def test_a_scan_without_any_line_is_refused_with_the_reason() -> None:
    with raises(NOTHING_LIT, match="no laser line"):
        require_lines([look("no laser line in view")], 1)


SATURATED_LOOK = Saturated("the image is saturated", limit="50%", got="100% of it")


def look(reason: str, code: str = NoLine.code) -> ScannedLook:
    return ScannedLook(number=0, lines=(), reason=reason, code=code, theatre_s=1.0)


@pytest.mark.branch("DARK_SCAN")
def test_saturated_pictures_are_counted_and_advised_as_such() -> None:
    beside = NotClear("the way is not clear")
    dark, saturated, unreached = (
        look(one.summary, one.code) for one in (NoLine("no laser line in view"), SATURATED_LOOK, beside)
    )
    with raises(NOTHING_LIT) as refused:
        require_lines([unreached, saturated, dark, saturated], 13)
    assert refused.value.what == f"none of the first 4 looks shows the line: {SATURATED_LOOK.summary}"
    assert refused.value.got == "2 saturated looks, 1 dark look, 1 unreached look of 13 planned"
    assert "shorten the exposure" in refused.value.advice
    assert "projector" not in refused.value.advice
    with raises(NOTHING_LIT, match=r"no laser line.*2 dark looks, 1 unreached look.*the projector lights"):
        require_lines([unreached, dark, dark], 3)


@pytest.mark.parametrize(("seen", "code"), [(SATURATED_LOOK, Saturated.code), (None, "")])
def test_a_look_says_by_its_picture_why_it_shows_no_line_and_not_by_its_way(seen, code: str) -> None:
    def go_over(place: object, _joints_rad: object) -> None:
        if place == "beside":
            raise NotClear("the way is not clear")

    places = iter(["there", "there", "beside"])
    tool_pose = SimpleNamespace(rotation_matrix=np.eye(3), displace=lambda _way: next(places))
    planned = SimpleNamespace(tool_pose=SimpleNamespace(transform=tool_pose), approach_rad=None)
    workcell = SimpleNamespace(look_at_line=lambda: SimpleNamespace(points=None, problem=seen))
    centring = SimpleNamespace(arriving=None, go_over=go_over)
    scanner = LookScanner(
        context_of(**vars(workcell)), 1, cast(Any, planned), cast(Any, centring), (0.0,) * 3
    )
    assert scanner.scan() == []
    assert scanner.code == (code or NotClear.code)


@pytest.mark.parametrize("usable", [True, False])
def test_the_laser_is_lit_for_its_own_pair_alone(usable: bool, monkeypatch: pytest.MonkeyPatch) -> None:
    lit: list[bool] = []

    class Switched(Head):
        def set_projector(self, on: bool, timeout_s: float = 5.0) -> None:
            self.projector_on = on

    def grab(stereo: Switched, clock: object) -> SimpleNamespace:
        lit.append(stereo.projector_on)
        if stereo.projector_on and not usable:
            raise PairNotUsable("no usable pair")
        return SimpleNamespace(left=None, right=None)

    def measure(*_images: object) -> None:
        raise NoLine("no laser line in view")

    monkeypatch.setattr(line_look, "grab_usable", grab)
    monkeypatch.setattr(line_look, "area_image", lambda _image: None)
    monkeypatch.setattr(line_look, "measure_line", measure)
    head = Switched()
    with nullcontext() if usable else pytest.raises(PairNotUsable):
        line_look.look_at_line(cast(Any, head), cast(Any, None), cast(Any, None))
    assert lit == [False, True]
    assert not head.projector_on


def test_the_pair_at_the_line_is_shown_with_the_points_that_were_measured() -> None:
    area = AreaOfInterest(100, 200, 400, 600)
    sides = [SimpleNamespace(serial=name, area=area, pixels=np.zeros((600, 400), np.uint8)) for name in "ab"]
    reading = cast(StereoReading, SimpleNamespace(left=sides[0], right=sides[1]))
    centres_px = np.array([[300.0, float(row)] for row in range(220, 780, 30)])
    line = LineImage(centres_px, *(np.zeros(1) for _ in range(6)))  # type: ignore[arg-type]  # not drawn
    seen = line_look.LineLook(reading, line, None, None, NoLine("no laser line in view"))
    shown = cv2.imdecode(np.frombuffer(pair_picture(seen, 300), np.uint8), cv2.IMREAD_COLOR)
    assert shown is not None
    caption_px = shown.shape[0] - 300
    columns, rows = np.unique(np.argwhere((shown == TRUSTED_BGR).all(axis=2))[:, 1]), shown[caption_px:, 100]
    assert {99, 100, 101} >= set(columns.tolist()) >= {100}  # of the left picture alone
    assert (rows == TRUSTED_BGR).all(axis=1).sum() >= len(centres_px)


def test_the_workcell_shows_each_pair_at_the_line(monkeypatch: pytest.MonkeyPatch) -> None:
    seen = line_look.LineLook(cast(StereoReading, None), None, None, None)
    shown: list[object] = []
    monkeypatch.setattr(workcell, "look_at_line", lambda *_arguments: seen)
    cell = SimpleNamespace(
        stereo=None, calibrations=SimpleNamespace(stereo_head=None), clock=None, on_look=shown.append
    )
    assert workcell.Workcell.look_at_line(cast(workcell.Workcell, cell)) is seen
    assert shown == [seen]


def test_a_recorded_scan_gives_back_points_and_covariances() -> None:
    line = ScannedLine(
        look=3,
        joints_rad=(0.0,) * 6,
        view_mm=(0.0, 0.0, 300.0),
        points_mm=((1.0, 2.0, 3.0), (1.5, 2.0, 3.0)),
        covariances_mm2=((4.0, 0.1, 0.2, 5.0, 0.3, 6.0),) * 2,
    )
    scanned = ScannedSurface.without_spheres(
        coarse_offset_mm=(0.0, 0.0, 0.0), lines=(line,), planned_looks=4, dark={}, covered=0.1, theatre_s=1.0
    )
    assert scanned.looks_taken == (3,)
    assert scanned.scan.points_mm.tolist() == [[1.0, 2.0, 3.0], [1.5, 2.0, 3.0]]
    expected = [[4.0, 0.1, 0.2], [0.1, 5.0, 0.3], [0.2, 0.3, 6.0]]
    assert scanned.scan.covariance_mm2.tolist() == [expected, expected]


def test_a_landmark_is_the_end_of_a_thin_ear_and_not_of_a_rest_beside_it() -> None:
    grid = np.indices((80, 80, 80)) - 40.0  # slices, rows, columns: superior, posterior, left
    voxels = np.full(grid.shape[1:], -1000, dtype=np.int16)
    voxels[np.linalg.norm(grid, axis=0) < 20.0] = 40
    voxels[38:43, 39:41, 55:71] = 40  # the ear, to 30 mm left
    voxels[38:43, 39:41, 74:78] = 40  # a shell that does not touch it
    geometry = VoxelGeometry((80, 80, 80), np.full(3, -40.0), np.eye(3)[:, ::-1], np.ones(3))
    volume = Volume(voxels, geometry, "1.2", "1.3")
    angles = np.linspace(0.0, np.pi, 40)
    skin = 20.0 * np.column_stack([np.sin(angles), np.zeros(40), np.cos(angles)])
    assert find_landmark(volume, skin, (1.0, 0.0, 0.0)) == pytest.approx([29.5, -0.5, 0.0], abs=0.6)


IN_CT_MM = np.array([[0.0, -105.0, -20.0], [78.0, 5.0, -15.0], [-78.0, 5.0, -15.0]])
TOUCHED_MM = IN_CT_MM + np.array([900.0, 0.0, 200.0])
NOSE_BESIDE_MM = np.array([[28.0, 0.0, 0.0], [0.0, 0.0, 0.0], [0.0, 0.0, 0.0]])


CLAMP_MM = TOUCHED_MM.mean(axis=0) + np.array([0.0, 230.0, -60.0])
SEMI_AXES_MM = np.array([75.0, 95.0, 85.0])
TRACKER_MM = np.array([[1500.0, 1200.0, 1500.0]])


def place(
    touched_mm: Array, reading: LandmarkReading = BY_POINTER, clamp_mm: Array | None = CLAMP_MM
) -> Array:
    """Fit the head of a patient who lies face up, the vertex away; return how far the landmarks are off."""
    sight = HeadSight(np.zeros(3), SEMI_AXES_MM, TRACKER_MM)
    sits = RoomPrior(np.array([0.0, -1.0, 0.0]), (60.0, 90.0), 30.0, sight, clamp_mm)
    return place_head(IN_CT_MM, touched_mm, sits, reading)[1]


def test_landmarks_touched_as_well_as_skin_permits_place_the_head() -> None:
    slips_mm = np.array([[3.0, -2.0, 2.0], [-3.0, 2.0, 1.0], [2.0, 3.0, -2.0]])
    assert place(TOUCHED_MM + slips_mm).max() < 4.0


def test_a_tape_may_err_by_centimetres_and_a_pointer_may_not() -> None:
    slips_mm = np.array([[15.0, -20.0, 10.0], [-15.0, 10.0, 12.0], [10.0, 20.0, -15.0]])
    assert place(TOUCHED_MM + slips_mm, BY_TAPE).max() < 30.0
    with pytest.raises(RonnaError, match="PRO-007"):
        place(TOUCHED_MM + slips_mm)
    with pytest.raises(RonnaError, match="PRO-007"):
        place(TOUCHED_MM + 3.0 * NOSE_BESIDE_MM, BY_TAPE)


@pytest.mark.branch("UNLIKE_LANDMARKS")
@pytest.mark.parametrize(
    ("touched_mm", "code", "said"),
    [
        (TOUCHED_MM + NOSE_BESIDE_MM, "PRO-007", "the tip of the nose fits worst"),
        (0.1 * TOUCHED_MM, "PRO-007", r"\(in cm\?\)"),
        (TOUCHED_MM[[0, 2, 1]], "REG-013", "the ears may have been exchanged"),
        (TOUCHED_MM[[1, 0, 2]], "PRO-007", r"from their fit: tip of the nose \d+ mm, left ear"),
        (TOUCHED_MM[[1, 0, 2]], "PRO-007", "the tip of the nose and the left ear may have been exchanged"),
        (
            TOUCHED_MM[[1, 2, 0]],
            "PRO-007",
            "in another order: left ear, right ear, tip of the nose",
        ),
        (TOUCHED_MM[[0, 1, 1]], "REG-004", "two of nose and ears were read at the same place"),
        (0.001 * TOUCHED_MM, "REG-004", r"\(in m\?\)"),
    ],
)
def test_a_mistyped_landmark_is_refused_with_the_slip_that_explains_it(
    touched_mm: Array, code: str, said: str
) -> None:
    with pytest.raises(RonnaError, match=f"{code}: .*{said}.*touch the point and read it again"):
        place(touched_mm)


def test_landmarks_that_fit_in_no_order_may_be_those_of_another_patient() -> None:
    with pytest.raises(RonnaError, match=r"PRO-007.*another patient than in the CT, or another CT"):
        place(TOUCHED_MM + NOSE_BESIDE_MM)
    with pytest.raises(RonnaError) as exchanged:
        place(TOUCHED_MM[[1, 0, 2]])
    assert "another patient" not in exchanged.value.advice


@pytest.mark.parametrize("entry_mm", [(40.0, -60.0, 70.0), (-40.0, -60.0, 5.0)])
def test_ears_that_were_exchanged_are_named_where_only_the_mark_of_an_entry_tells(
    entry_mm: Vector3, monkeypatch: pytest.MonkeyPatch
) -> None:
    mark_mm = Start.from_landmarks(IN_CT_MM, TOUCHED_MM, 4.0).robot_from_ct.apply(entry_mm)
    monkeypatch.setattr(surface_start, "touch_head", lambda *_arguments, **_words: mark_mm)
    planned = SimpleNamespace(id="T1", entry_mm=entry_mm)
    plan = cast(Any, SimpleNamespace(plan=SimpleNamespace(trajectories=(planned,))))
    anything = cast(
        Any, SimpleNamespace(check_position=lambda *_: "", sight=SimpleNamespace(centre_mm=np.zeros(3)))
    )
    axes = cast(Any, SimpleNamespace(middle_mm=np.zeros(3)))
    for order, said in (([0, 2, 1], "the ears may have been exchanged"), ([0, 1, 2], "")):
        read_mm = TOUCHED_MM[order]
        guess = partial(guess_order, IN_CT_MM, read_mm, anything, BY_POINTER)
        pose = Start.from_landmarks(IN_CT_MM, read_mm, 4.0).robot_from_ct
        with (
            nullcontext() if not said else pytest.raises(RonnaError, match=f"SRF-006.*{said}.*touch nose and")
        ):
            surface_start.touch_site(cast(Any, None), plan, pose, axes, guess)


@pytest.mark.parametrize(
    ("measured_mm", "code"),
    [
        (TOUCHED_MM + 3.0 * NOSE_BESIDE_MM, "PRO-007"),
        (TOUCHED_MM[[0, 2, 1]], "REG-013"),
        (TOUCHED_MM[[0, 1, 1]], "REG-004"),
    ],
)
def test_whoever_held_the_tape_wrongly_is_told_how_to_measure_again(measured_mm: Array, code: str) -> None:
    with pytest.raises(
        RonnaError, match=f"{code}: .*Measure again.*tip of the nose.*left ear, then the right"
    ):
        place(measured_mm, BY_TAPE)


@pytest.mark.parametrize(
    ("from_mm", "said"),
    [
        ((400.0, 0.0, 0.0), "mm from the frame on its clamp, limit 400 mm"),
        ((0.0, 230.0, -60.0), "would hide the frame on its clamp"),
        ((50.0, 280.0, 40.0), "would hide the frame on its clamp"),
    ],
    ids=["a tape held from another place", "about the frame itself", "between the frame and the tracker"],
)
def test_a_head_that_its_clamp_does_not_allow_is_refused(from_mm: tuple[float, ...], said: str) -> None:
    measured_mm = TOUCHED_MM + np.array(from_mm)
    assert place(measured_mm, BY_TAPE, clamp_mm=None).max() < 1.0
    with raises(HeadElsewhere, match=said):
        place(measured_mm, BY_TAPE)
