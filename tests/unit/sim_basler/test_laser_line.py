"""The projector's line in a picture: where it is, what hides it, how it is lit, and when it is dark."""

from __future__ import annotations

import numpy as np
import pytest
from camera_views import FULL, bare_camera
from numpy.typing import NDArray

from sim.basler.camera.line_view import LineView, is_under_hair
from sim.basler.camera.photographer import Photographer
from sim.basler.optics.canvas import Lens, PixelCanvas
from sim.basler.optics.laser_light import add_core, add_glow, project_runs
from sim.basler.optics.laser_line import FILM, HAIR, SKIN, Hair, LineRun, beam_sigma_mm, trace_line
from sim.basler.optics.laser_line import Body as LitBody
from sim.basler.optics.speckle import PATTERNS, Speckle
from sim.basler.settings import CameraSettings, FrameSettings
from sim.world.displacements import NOTHING_MOVED
from sim.world.head_surface.bare_bone import BareBone, HeadWithBareBone
from sim.world.head_surface.ellipsoidal_head import EllipsoidalHead
from sim.world.head_surface.parametric_head import ParametricHead
from sim.world.head_surface.skull_surface import SkullSurface
from sim.world.options import Carrier
from sim.world.rigid import Vector, apply, as_point, inverse, matrix_from, matrix_of, rotation_towards
from sim.world.scene.as_built import draw_projector
from sim.world.scene.named_scenes import draw_scene
from sim.world.scene.skin import skin_in_theatre
from sim.world.world import ArmState, World

PROJECTOR = draw_projector(0)
CAMERA = bare_camera()
LENS = Lens.from_camera(CAMERA)
CAMERA_FROM_TOOL = matrix_of(CAMERA.camera_from_tool)
TOOL_FROM_PROJECTOR = matrix_of(PROJECTOR.tool_from_projector)
RADIUS_MM = 60.0
HEAD = EllipsoidalHead((0.0, 0.0, RADIUS_MM), (RADIUS_MM,) * 3)  # its skin at the tool centre point


class Even:
    """No speckle."""

    def at(self, columns: NDArray[np.intp], rows: NDArray[np.intp]) -> NDArray[np.float32]:
        return np.ones(columns.shape, np.float32)


def trace(*others: LitBody, hair: Hair | None = None) -> tuple[LineRun, ...]:
    """The line on the head and other bodies in the tool's frame, which is that of the CT here."""
    bodies = (LitBody(HEAD, SKIN), *others)
    return trace_line(PROJECTOR, TOOL_FROM_PROJECTOR, CAMERA_FROM_TOOL, (LENS, FULL), bodies, hair)


def picture(runs: tuple[LineRun, ...], *, glow: bool = False, speckle: object = None) -> NDArray[np.float32]:
    canvas = PixelCanvas(FULL, np.zeros((FULL.height, FULL.width), np.float32))
    drawn = project_runs(runs, LENS, FULL)
    if glow:
        add_glow(canvas, drawn)
    add_core(canvas, drawn, speckle or Even())  # type: ignore[arg-type]
    return canvas.light


def centres(light: NDArray[np.float32]) -> tuple[NDArray[np.float64], NDArray[np.intp]]:
    """Centre of gravity of each lit row."""
    rows = np.flatnonzero(light.max(axis=1) > 0.5)
    columns = np.arange(light.shape[1])
    return (light[rows] @ columns) / light[rows].sum(axis=1), rows


def test_the_line_is_where_the_sheet_of_light_meets_the_skin() -> None:
    columns, rows = centres(picture(trace()))
    rays = np.column_stack([LENS.rays(np.column_stack([columns, rows])), np.ones(len(rows))])
    tool_from_camera = inverse(CAMERA_FROM_TOOL)
    eye, directions = tool_from_camera[:3, 3], rays @ tool_from_camera[:3, :3].T
    sheet, origin = TOOL_FROM_PROJECTOR[:3, 1], TOOL_FROM_PROJECTOR[:3, 3]
    points = eye + ((origin - eye) @ sheet / (directions @ sheet))[:, None] * directions
    assert len(rows) > 1000
    assert np.abs(HEAD.distance_mm(points)).max() < 0.002


def test_blur_spreads_the_light_of_a_line_and_loses_none() -> None:
    def flux(depth_mm: float) -> float:
        points = np.column_stack([np.zeros(9), np.linspace(-5, 5, 9), np.full(9, depth_mm)])
        across = np.tile([0.05, 0.0, 0.0], (9, 1))
        run = LineRun(points, across, np.full(9, depth_mm), np.zeros(9), FILM)  # light per width in the image
        return float(picture((run,))[FULL.height // 2].sum())

    assert flux(265.0) == pytest.approx(flux(LENS.focus_mm), rel=0.01)


def test_light_scattered_in_skin_is_wider_than_the_line_but_has_its_centre() -> None:
    sharp, glowing = picture(trace()), picture(trace(), glow=True)
    row = FULL.height // 2
    middle = int(centres(sharp)[0][row])
    assert sharp[row, middle - 150] == 0.0
    assert glowing[row, middle - 150] > 0.0
    assert glowing[row, middle - 150] == pytest.approx(glowing[row, middle + 150], rel=0.1)


def test_the_beam_is_narrowest_at_its_focus() -> None:
    away = PROJECTOR.focus_mm + np.array([-40.0, 0.0, 40.0])
    near, focus, far = beam_sigma_mm(PROJECTOR, away)
    assert focus == pytest.approx(PROJECTOR.width_mm / 4.0)
    assert near == pytest.approx(far)
    assert near > 1.1 * focus


def test_a_hand_takes_part_of_the_line_and_casts_a_shadow() -> None:
    hand = LitBody(EllipsoidalHead((8.0, 0.0, -10.0), (12.0,) * 3), SKIN)
    without, runs = trace(), trace(hand)
    on_head = [run for run in runs if _is_on(HEAD, run)]
    on_hand = [run for run in runs if _is_on(hand.surface, run)]  # type: ignore[arg-type]
    assert on_hand
    assert sum(len(run.points_mm) for run in on_head) < 0.7 * sum(len(run.points_mm) for run in without)


def test_a_sphere_in_the_line_is_lit() -> None:
    sphere = LitBody(EllipsoidalHead((0.0, 0.0, -8.0), (5.75,) * 3), FILM)
    assert any(run.finish is FILM for run in trace(sphere))


def test_hair_breaks_the_line_and_lies_before_the_skin() -> None:
    def is_hidden(points: Vector) -> NDArray[np.bool_]:
        return np.asarray(np.abs(points[:, 0]) < 3.0)

    runs = trace(hair=Hair(is_hidden, lambda points: np.full(len(points), 4.0)))
    skin, strands = ([run for run in runs if run.finish is finish] for finish in (SKIN, HAIR))
    assert len(skin) == 2
    assert all(np.abs(run_in_tool(run)[:, 0]).min() > 2.9 for run in skin)
    height = np.concatenate([HEAD.distance_mm(run_in_tool(run)) for run in strands])
    assert height.max() > 1.0
    assert max(run.light.max() for run in strands) < 0.2 * max(run.light.max() for run in skin)


def test_skin_mirrors_spots_that_saturate_and_film_does_not() -> None:
    gloss = np.concatenate([run.gloss for run in trace()])
    light = np.concatenate([run.light for run in trace()])
    assert gloss.max() > 2.0 * light.max()
    assert np.median(gloss) < np.median(light)


def test_speckle_has_the_contrast_of_its_patterns_and_grains_of_a_pixel_or_two() -> None:
    rows, columns = np.mgrid[:256, :256]
    grain = Speckle(0, "left", 1).at(columns, rows).astype(float)
    assert grain.mean() == pytest.approx(1.0, abs=1e-3)
    assert 0.5 * PATTERNS**-0.5 < grain.std() < PATTERNS**-0.5  # pixels average over grains
    neighbours = [np.corrcoef(grain[:, by:].ravel(), grain[:, : -by or None].ravel())[0, 1] for by in (1, 4)]
    assert neighbours[0] > 0.2
    assert abs(neighbours[1]) < 0.05
    other = Speckle(0, "left", 2).at(columns, rows)
    assert abs(np.corrcoef(grain.ravel(), other.ravel())[0, 1]) < 0.05


# --- in a theatre -------------------------------------------------------------------------------------------

SURFACE = draw_scene("mini", fiducials=Carrier.SURFACE)
LEFT = SURFACE.left.serial
FRAME = CameraSettings(exposure_us=2000).frame()
LIT = FrameSettings(**{**vars(FRAME), "line_lit": True})


@pytest.fixture
def world() -> World:
    made = World.create(SURFACE, paced=False)
    aim_at_brow(made)
    return made


def aim_at_brow(world: World) -> None:
    scene = world.scene
    robot_from_ct, centre = matrix_of(scene.head.robot_from_ct), np.array(scene.head.centre_ct_mm)
    outwards = np.array([0.2, -1.0, 0.1]) / np.linalg.norm([0.2, -1.0, 0.1])
    start = centre + 300.0 * outwards
    (away,) = skin_in_theatre(scene.head).cast(start[None], -outwards[None], 400.0)
    tool = robot_from_ct @ matrix_from(start - away * outwards, rotation_towards(-outwards, (0.0, 0.0, 1.0)))
    flange = tool @ inverse(matrix_of(scene.mount.flange_from_tool_true))
    world.publish_arm(ArmState((0.0,) * 6, flange, 1, True))


def bright_rows(image: bytes) -> int:
    """Rows of an image in which something is much brighter than the background."""
    return int((pixels_of(image).max(axis=1) > 60).sum())


def pixels_of(image: bytes) -> NDArray[np.uint8]:
    return np.frombuffer(image, np.uint8).reshape(FULL.height, FULL.width)


def test_a_lit_line_shows_on_the_face_and_an_unlit_one_does_not(world: World) -> None:
    photographer = Photographer(world, SURFACE.left)
    assert bright_rows(photographer.triggered(LIT, 1)) > 900
    assert bright_rows(photographer.triggered(FRAME, 1)) == 0
    assert photographer.triggered(LIT, 1) == photographer.triggered(LIT, 1)


def test_both_cameras_see_one_line_on_the_skin(world: World) -> None:
    view = [LineView(SURFACE, camera) for camera in (SURFACE.left, SURFACE.right)]
    ct_from_tool = inverse(matrix_of(SURFACE.head.robot_from_ct)) @ world.robot_from_tool()
    skin = skin_in_theatre(SURFACE.head)
    for line, camera in zip(view, (SURFACE.left, SURFACE.right), strict=True):
        camera_from_tool = matrix_of(camera.camera_from_tool)
        runs = line.runs(FULL, world.robot_from_tool(), camera_from_tool, (), NOTHING_MOVED)
        points = np.concatenate([run.points_mm for run in runs if run.finish is SKIN])
        assert np.abs(skin.distance_mm(apply(ct_from_tool @ inverse(camera_from_tool), points))).max() < 0.01


def test_a_projector_without_light_is_dark_although_its_line_is_high(world: World) -> None:
    world.set_fault_script("now: camera projector dark for 60 s")
    assert bright_rows(Photographer(world, SURFACE.left).triggered(LIT, 1)) == 0


def test_a_hand_moves_half_of_the_line_elsewhere(world: World) -> None:
    def columns() -> NDArray[np.intp]:
        image = Photographer(world, SURFACE.left).triggered(LIT, 1)
        return np.asarray(pixels_of(image).argmax(axis=1))

    before = columns()
    world.set_fault_script("now: camera hand 5 mm for 60 s")
    moved = np.abs(columns() - before) > 50
    assert 0.25 < moved.mean() < 0.75


def test_a_lamp_brightens_the_skin_with_and_without_the_line(world: World) -> None:
    def median(frame: FrameSettings) -> float:
        return float(
            np.median(np.frombuffer(Photographer(world, SURFACE.left).triggered(frame, 1), np.uint8))
        )

    before = median(LIT)
    world.set_fault_script("now: camera lamp 50 % for 60 s")
    assert median(LIT) > before + 20
    assert median(FRAME) > before + 20


def _is_on(surface: EllipsoidalHead, run: LineRun) -> bool:
    return bool(np.abs(surface.distance_mm(run_in_tool(run))).max() < 0.01)


def run_in_tool(run: LineRun) -> Vector:
    """Points of a run in the tool's frame."""
    return apply(inverse(CAMERA_FROM_TOOL), run.points_mm)


def test_no_hair_grows_on_bare_bone() -> None:
    head = draw_scene("mini", seed=1, fiducials=Carrier.SURFACE).head
    assert head.face is not None
    hairy = head.face.model_copy(update={"hair_mm": 8.0, "hair_share": 0.9})
    hairy_head = ParametricHead(head.centre_ct_mm, head.semi_axes_mm, hairy)
    vertex = np.add(head.centre_ct_mm, (0.0, 0.0, head.semi_axes_mm[2]))
    around = vertex + np.random.default_rng(0).normal(scale=6.0, size=(60, 3))
    opening = BareBone(centre_ct_mm=as_point(vertex), radius_mm=60.0)
    bare = HeadWithBareBone(hairy_head, SkullSurface(hairy_head), opening)
    assert is_under_hair(hairy_head, hairy_head, around).mean() > 0.5
    assert not is_under_hair(hairy_head, bare, around).any()
