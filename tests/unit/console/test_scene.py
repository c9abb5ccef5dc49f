"""The scene: poses of the bodies, the closest pair, lines of sight, and the surface of the head."""

from __future__ import annotations

import math
import struct
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from case_events import question
from nicegui import context, ui
from shown_page import on_a_page

from console.figures import LatestFigures
from console.guard import Session, SessionRole
from console.hub import Hub
from console.panels.results import LogTail
from console.scene.bodies import closest_pair, rotation_along
from console.scene.head_surface import corner_normals, encode_stl, find_series_folder, head_surface
from console.scene.scanned_skin import COVERED, MISSING
from console.scene.sights import is_hidden, volume_edges
from console.scene.theatre_scene import ScenePanel, TheatreScene
from console.web.page import CasePage
from procedures.engine.case_view import CaseView, ReportedPose
from procedures.engine.events import Bodies, Body, MeasuringVolume, Pose, ScanProgress
from procedures.imaging.volume import Volume, VoxelGeometry
from procedures.reporting.case_figures import CaseFigures, SphereFigure, TrajectoryFigure
from procedures.runs.orders import SentOrder
from ronna_hw.frames import Frame, Transform


@pytest.mark.parametrize("end", [(0, 0, 5), (0, 0, -5), (3, 0, 0), (1, -2, 3), (0, 4, 0)])
def test_a_capsule_is_drawn_along_its_axis_and_not_mirrored(end: tuple[float, float, float]) -> None:
    rotation = np.array(rotation_along((0.0, 0.0, 0.0), end))
    assert rotation @ [0, 0, 1] == pytest.approx(np.array(end) / math.hypot(*end))
    assert np.linalg.det(rotation) == pytest.approx(1.0)
    assert rotation @ rotation.T == pytest.approx(np.eye(3))


BODIES = Bodies(
    moving=(Body(name="hand", radius_mm=10.0), Body(name="needle", radius_mm=1.0)),
    fixed=(
        Body(name="column", radius_mm=50.0, ends_mm=(0, 0, 0, 0, 0, 100)),
        Body(name="clamp", radius_mm=5.0, ends_mm=(200, -50, 0, 200, 50, 0)),
    ),
    pairs=((0, 0), (0, 1), (1, 1), (1, -1)),
)


def test_the_closest_checked_pair_is_named_with_its_clearance_and_location() -> None:
    pose = Pose(
        arm="arm",
        joints_rad=(0.0,),
        age_s=0.0,
        bodies_mm=((100, 0, 200, 150, 0, 200), (150, 0, 200, 200, 10, 40)),
    )
    apart = BODIES.model_copy(update={"pairs": BODIES.pairs[:3]})
    closest = closest_pair(apart, pose)
    assert closest is not None
    assert (closest.first, closest.second, closest.distance_mm) == ("needle", "clamp", pytest.approx(34.0))
    assert closest.from_mm == pytest.approx((200, 10, 40), abs=1e-3)
    assert closest.to_mm == pytest.approx((200, 10, 0), abs=1e-3)


def test_a_pair_of_the_arms_own_bodies_is_shown_below_the_clearance_of_planned_paths() -> None:
    places = ((0, 0, 0, 100, 0, 0), (0, 0, 25, 100, 0, 25))  # 14 mm between hand and needle
    pose = Pose(arm="arm", joints_rad=(0.0,), age_s=0.0, bodies_mm=places)
    own = BODIES.model_copy(update={"pairs": ((1, -1),)})
    assert closest_pair(own, pose) is None
    near = closest_pair(own.model_copy(update={"margin_mm": 15.0}), pose)
    assert near is not None
    assert (near.first, near.second) == ("needle", "hand")


def test_a_pose_without_matching_bodies_has_no_clearance() -> None:
    assert closest_pair(BODIES, Pose(arm="arm", joints_rad=(0.0,), age_s=0.0)) is None


@pytest.mark.parametrize(
    "change",
    [
        {"pairs": ((7, 0),)},
        {"pairs": ((0, -9),)},
        {"fixed": ({"name": "column", "radius_mm": 50.0, "ends_mm": (0, 0)},), "pairs": ()},
        {"cameras": ({"name": "left", "points_mm": (0, 0)},)},
    ],
)
def test_bodies_that_cannot_be_drawn_are_refused_as_the_events_are_read(change: dict[str, object]) -> None:
    with pytest.raises(ValueError, match=r"is not there|two ends|four corners"):
        Bodies.model_validate({**BODIES.model_dump(), **change})


@pytest.mark.parametrize("change", [{"tool_mm": (1.0,)}, {"bodies_mm": ((0.0,),)}])
def test_a_pose_that_cannot_be_drawn_is_refused(change: dict[str, object]) -> None:
    pose = {"arm": "arm", "joints_rad": (0.0,), "age_s": 0.0}
    with pytest.raises(ValueError, match=r"origin|at least 6"):
        Pose.model_validate({**pose, **change})


EYE, SPHERE = (0.0, 0.0, 0.0), (1000.0, 0.0, 0.0)


def test_a_measuring_volume_is_drawn_as_its_sections_and_the_edges_between_them() -> None:
    volume = MeasuringVolume(device="tracker", sections_mm=((-950.0, 200.0, 300.0), (-2400.0, 600.0, 700.0)))
    edges = volume_edges(volume)
    assert len(edges) == 12
    assert ((-200.0, -300.0, -950.0), (200.0, -300.0, -950.0)) in edges
    assert ((200.0, 300.0, -950.0), (600.0, 700.0, -2400.0)) in edges
    assert volume_edges(None) == []


@pytest.mark.parametrize(("beside_mm", "hidden"), [(0.0, True), (39.0, True), (41.0, False)])
def test_a_body_that_intersects_a_line_of_sight_hides_it(beside_mm: float, hidden: bool) -> None:
    bodies = Bodies(moving=(Body(name="forearm", radius_mm=40.0),), fixed=(), pairs=())
    axis = (500.0, beside_mm, -200.0, 500.0, beside_mm, 200.0)
    pose = Pose(arm="arm", joints_rad=(0.0,), age_s=0.0, bodies_mm=(axis,))
    assert is_hidden(EYE, SPHERE, bodies, pose) is hidden


def test_a_pose_without_matching_bodies_hides_nothing() -> None:
    bodies = Bodies(moving=(Body(name="forearm", radius_mm=40.0),), fixed=(), pairs=())
    assert not is_hidden(EYE, SPHERE, bodies, Pose(arm="arm", joints_rad=(0.0,), age_s=0.0))


PLACED = CaseFigures(
    robot_from_ct=Transform.of(
        Frame.ROBOT, Frame.CT, translation_mm=(700.0, 0.0, 300.0), quaternion_wxyz=(1.0, 0.0, 0.0, 0.0)
    )
)
THEATRE_BODIES = Bodies(
    moving=(Body(name="hand", radius_mm=10.0),),
    fixed=(Body(name="column", radius_mm=50.0, ends_mm=(0, 0, 0, 0, 0, 100)),),
    pairs=((0, 0),),
)
NEAR = Pose(arm="arm", joints_rad=(0.0,), age_s=0.0, bodies_mm=((100, 0, 0, 100, 0, 100),))
FAR = NEAR.model_copy(update={"bodies_mm": ((5000, 0, 0, 5000, 0, 100),)})
OTHER_TOOL = NEAR.model_copy(update={"bodies_mm": (*NEAR.bodies_mm, *NEAR.bodies_mm)})


def in_a_scene(do: Callable[[TheatreScene], None]) -> None:
    on_a_page(lambda: do(TheatreScene(low=True)))


def test_a_head_whose_place_is_no_longer_known_is_not_drawn_until_it_is_known_again() -> None:
    def do(scene: TheatreScene) -> None:
        scene.show(CaseView(), PLACED, 1)
        assert scene._head.visible_
        scene.show(CaseView(), replace(PLACED, robot_from_ct=None), 1)
        assert not scene._head.visible_
        scene.show(CaseView(), PLACED, 1)
        assert scene._head.visible_
        scene.show(CaseView(), None, 1)
        assert not scene._head.visible_

    in_a_scene(do)


def test_the_clearance_disappears_when_nothing_is_near_and_when_it_is_not_known() -> None:
    def do(scene: TheatreScene) -> None:
        near = CaseView(bodies={"arm": THEATRE_BODIES}, poses={"arm": ReportedPose(NEAR, 0.0)})
        for other in (
            replace(near, poses={"arm": ReportedPose(FAR, 0.0)}),
            replace(near, poses={"arm": ReportedPose(OTHER_TOOL, 0.0)}),
            replace(near, poses={}),
            replace(near, poses={}, bodies={"arm": THEATRE_BODIES.model_copy()}),
        ):
            scene.show(near, None, 0)
            assert list(scene.closest) == ["arm"]
            assert scene._arms["arm"]._near.group.visible_
            scene.show(other, None, 0)
            assert scene.closest == {}
            assert not scene._arms["arm"]._near.group.visible_

    in_a_scene(do)


def test_the_instrument_is_drawn_from_the_end_of_the_guide_to_the_planned_target_while_it_is_there() -> None:
    tool = ((0, 0, 400, 0, 0, 190), (-8, 2, 180, 8, 2, 180))  # of a guide that ends 30 mm before the entry
    links = ((500, 0, 0, 500, 0, 900),) * 4
    pose = NEAR.model_copy(update={"bodies_mm": (*links, *tool)})
    path = TrajectoryFigure("T2", entry_mm=(0.0, 0.0, 150.0), target_mm=(0.0, 0.0, 100.0))
    there = CaseFigures(trajectories=(path,))
    asked = question(topic="at_target:T2")

    def do(scene: TheatreScene) -> None:
        poses = {"arm": ReportedPose(pose, 0.0)}
        view = CaseView(bodies={"arm": THEATRE_BODIES}, poses=poses, question=asked)
        scene.show(view, there, 0)
        assert scene._instrument_ends == ((0.0, 0.0, 180.0), path.target_mm)
        rod, caption = scene._instrument
        assert (rod.z, rod.sz) == (pytest.approx(0.18), pytest.approx(0.08))
        assert caption.args[0] == "instrument, as planned"
        for other in (None, asked.model_copy(update={"topic": "retreat:T2"})):
            scene.show(view, there, 0)
            scene.show(replace(view, question=other), there, 0)
            assert scene._instrument == []
        scene.show(view, None, 0)
        assert scene._instrument == []

    in_a_scene(do)


def test_covered_skin_grows_over_the_head_and_the_camera_stands_before_the_face() -> None:
    places = ((0.0, -90.0, 0.0), (20.0, -85.0, 0.0))
    scan = ScanProgress(
        looks_done=0, looks_planned=2, covered_share=0.0, predicted_error_mm=None, missing_mm=places
    )
    half = scan.model_copy(update={"covered_mm": places[:1], "missing_mm": places[1:]})

    def do(scene: TheatreScene) -> None:
        def clouds() -> dict[str, list[list[float]]]:
            return {cloud.color: np.array(cloud.args[0]).tolist() for cloud in scene.skin._clouds}

        scene.show(CaseView(scan=scan), PLACED, 1)
        assert list(clouds()) == [MISSING]
        scene.show(CaseView(scan=half), PLACED, 1)
        assert clouds() == {
            COVERED: [pytest.approx([0.7, -0.09, 0.3])],
            MISSING: [pytest.approx([0.72, -0.085, 0.3])],
        }
        assert scene.skin.camera == (
            pytest.approx((710.0, -637.5, 440.0)),
            pytest.approx((710.0, -87.5, 300.0)),
        )
        same = scene.skin._clouds
        scene.show(CaseView(scan=half), PLACED, 1)
        assert scene.skin._clouds is same
        for gone in (CaseView(), CaseView(scan=half.model_copy(update={"covered_mm": (), "missing_mm": ()}))):
            scene.show(gone, PLACED, 1)
            assert (scene.skin._clouds, scene.skin.camera) == ([], None)
        scene.show(CaseView(scan=half), None, 1)
        assert scene.skin._clouds == []

    in_a_scene(do)


SHAPE = (60, 80, 70)  # slices, rows, columns
SPACING_MM = np.array([2.0, 1.0, 1.5])
ORIGIN_MM = np.array([-50.0, -30.0, 700.0])
AXES = np.array([[0.0, 0.0, 1.0], [0.0, 1.0, 0.0], [1.0, 0.0, 0.0]])  # slices go up, columns left


def scan(mark: bool = True) -> Volume:
    """A ball with an air-filled hollow, a mark on its left side, and a headrest that is no head."""
    geometry = VoxelGeometry(SHAPE, ORIGIN_MM, AXES, SPACING_MM)
    places = np.moveaxis(np.indices(SHAPE), 0, -1)
    lps = geometry.to_patient_mm(places)
    middle = geometry.to_patient_mm(np.array(SHAPE) / 2)
    radius = np.linalg.norm(lps - middle, axis=-1)
    solid = (radius < 25.0) & (radius > 8.0)
    if mark:
        solid |= (np.abs(lps - middle - [28.0, 0.0, 0.0]) < 7.0).all(axis=-1)
    solid |= lps[..., 1] > middle[1] + 36.0
    return Volume(np.where(solid, 40, -1000).astype(np.int16), geometry, "1.2", "1.3")


def test_the_surface_is_the_filled_head_without_the_headrest_and_not_mirrored() -> None:
    volume = scan()
    corners, triangles = head_surface(volume)
    middle = volume.geometry.to_patient_mm(np.array(SHAPE) / 2)
    from_middle = corners - middle
    distances = np.linalg.norm(from_middle, axis=1)
    assert distances.min() > 20.0  # the hollow is filled
    assert from_middle[:, 1].max() < 30.0  # without the headrest, which is posterior
    assert from_middle[:, 0].max() > 31.0  # the mark is left
    assert from_middle[:, 0].min() > -28.0
    assert np.median(distances) == pytest.approx(25.0, abs=1.5)
    assert triangles.max() < len(corners)


def test_normals_at_the_corners_point_out_of_the_head() -> None:
    corners, triangles = head_surface(scan(mark=False))
    from_middle = corners - scan().geometry.to_patient_mm(np.array(SHAPE) / 2)
    normals = corner_normals(corners, triangles)
    directions = from_middle / np.linalg.norm(from_middle, axis=1, keepdims=True)
    assert np.sum(normals * directions, axis=1).min() > 0.8
    assert corner_normals(corners, triangles[:, ::-1]) == pytest.approx(normals)


def test_an_empty_scan_has_no_head() -> None:
    geometry = VoxelGeometry(SHAPE, ORIGIN_MM, AXES, SPACING_MM)
    with pytest.raises(ValueError, match="only air"):
        head_surface(Volume(np.full(SHAPE, -1000, np.int16), geometry, "1.2", "1.3"))


def test_the_mesh_is_written_as_binary_stl_in_metres() -> None:
    corners = np.array([[0.0, 0.0, 0.0], [1000.0, 0.0, 0.0], [0.0, 1000.0, 0.0]])
    content = encode_stl(corners, np.array([[0, 1, 2]]))
    assert len(content) == 84 + 50
    assert struct.unpack("<I12f", content[80:132]) == (1, 0, 0, 1, 0, 0, 0, 1, 0, 0, 0, 1, 0)


def test_the_series_in_the_run_folder_takes_precedence_over_the_one_in_the_request(tmp_path: Path) -> None:
    assert find_series_folder(tmp_path) is None
    (tmp_path / "request.json").write_text('{"case": "/data/case-7"}')
    assert find_series_folder(tmp_path) == Path("/data/case-7/ct")
    (tmp_path / "case" / "ct").mkdir(parents=True)
    assert find_series_folder(tmp_path) == tmp_path / "case" / "ct"


def test_the_theatre_comes_with_the_page_and_waits_for_no_connection(tmp_path: Path) -> None:
    hub = Hub(tmp_path)
    hub.show(CaseView(bodies={"arm": BODIES}))

    async def drawn() -> set[str]:
        session = Session(SessionRole.VIEWER, "session-1")
        CasePage(hub, LatestFigures(hub), LogTail(tmp_path), session, low=True).build()
        scenes = [one for one in context.client.elements.values() if isinstance(one, ui.scene)]
        return {body.name for scene in scenes for body in scene.objects.values()}

    assert {"column", "clamp"} <= on_a_page(drawn)


def test_on_the_page_of_a_closed_case_no_age_stands_and_neither_stop_nor_the_seat_is_offered(
    tmp_path: Path,
) -> None:
    async def send(_order: SentOrder) -> None:
        """Take the order."""

    async def shown(view: CaseView) -> tuple[bool, bool, str]:
        hub = Hub(tmp_path)
        hub.connect(send)
        hub.show(view)
        session = Session(SessionRole.OPERATOR, "session-1")
        CasePage(hub, LatestFigures(hub), LogTail(tmp_path), session, low=True).build()
        elements = [*context.client.elements.values()]
        stop, claim = (
            next(one for one in elements if one.props.get("data-do") == name) for name in ("stop", "claim")
        )
        words = "".join(one.content for one in elements if isinstance(one, ui.html))
        return isinstance(stop, ui.button) and stop.enabled, claim.visible, words

    under_way = CaseView(bodies={"arm": BODIES}, poses={"arm": ReportedPose(NEAR, 0.0)})
    may_stop, may_sit, words = on_a_page(lambda: shown(under_way))
    assert (may_stop, may_sit) == (True, True)
    assert "pose is 0.00 s old" in words
    may_stop, may_sit, words = on_a_page(lambda: shown(replace(under_way, outcome="finished")))
    assert (may_stop, may_sit) == (False, False)
    assert "s old" not in words
    assert "pose as last read before the case was closed" in words


@pytest.mark.parametrize("has_spheres", [True, False])
def test_the_key_names_spheres_only_in_a_case_that_has_them(*, has_spheres: bool) -> None:
    sphere = SphereFigure(number=1, ct_mm=(0.0, 0.0, 0.0), tracker_mm=None, stereo_mm=None)

    def words() -> str:
        panel = ScenePanel(low=True)
        panel.show(CaseView(), CaseFigures(spheres=(sphere,) if has_spheres else ()), heads=0)
        return panel._key.content

    shown = on_a_page(words)
    assert ("spheres from the CT" in shown) is has_spheres
    assert "stereo head" in shown
