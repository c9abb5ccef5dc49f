import json
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from coded_errors import raises
from scipy.spatial.transform import Rotation

from ronna_hw.x_frame import SPHERE_CENTRES_MM, bodies
from sim.errors import BAD_SCENE
from sim.world.options import Carrier
from sim.world.scene.head import SMALLEST_DISTANCE_MM
from sim.world.scene.model import parse_scene, read_scene
from sim.world.scene.named_scenes import add_patient_frame, draw_scene


def test_the_same_seed_draws_the_same_scene_and_another_seed_a_different_one() -> None:
    assert draw_scene("default", seed=3) == draw_scene("default", seed=3)
    assert draw_scene("default", seed=3) != draw_scene("default", seed=4)


@pytest.mark.parametrize(("name", "markers", "targets"), [("default", 5, 3), ("mini", 3, 1)])
def test_the_built_in_scenes_have_their_promised_size(name: str, markers: int, targets: int) -> None:
    scene = draw_scene(name)
    assert (len(scene.head.fiducials), len(scene.head.targets)) == (markers, targets)


@pytest.mark.parametrize("seed", range(10))
def test_three_spheres_can_be_told_apart_by_their_distances(seed: int) -> None:
    head = draw_scene("mini", seed=seed).head
    centres = np.array([fiducial.centre_ct_mm for fiducial in head.fiducials])
    sides = sorted(np.linalg.norm(centres - np.roll(centres, 1, axis=0), axis=1))
    assert sides[0] >= SMALLEST_DISTANCE_MM
    assert min(np.diff(sides)) >= 6.0


@pytest.mark.parametrize("seed", range(10))
def test_targets_lie_inside_the_head_and_entries_on_its_skin(seed: int) -> None:
    head = draw_scene("default", seed=seed).head
    for target in head.targets:
        relative = [np.subtract(p, head.centre_ct_mm) for p in (target.entry_ct_mm, target.target_ct_mm)]
        entry, inside = (float(np.linalg.norm(p / np.array(head.semi_axes_mm))) for p in relative)
        assert entry == pytest.approx(1.0, abs=1e-6)
        assert inside < 0.95


@pytest.mark.parametrize(("markers", "targets"), [(2, 1), (9, 1), (4, 0), (4, 11)])
def test_impossible_numbers_of_markers_or_targets_are_refused(markers: int, targets: int) -> None:
    with raises(BAD_SCENE):
        draw_scene("default", markers=markers, targets=targets)


def test_all_mistakes_of_a_scene_are_reported_at_once() -> None:
    content = draw_scene("mini").model_dump(by_alias=True)
    content["colour"] = "green"
    content["seed"] = "x"
    with raises(BAD_SCENE, match=r"2 mistakes"):
        parse_scene(content, "scene.toml")


@pytest.mark.parametrize(
    ("path", "value", "said"),
    [
        (("seed",), -1, "seed"),
        (("head", "fiducials"), [], "head.fiducials"),
        (("head", "targets"), [], "head.targets"),
        (("head", "fiducials", 0, "radius_mm"), -5.75, "head.fiducials 1.radius_mm"),
        (("head", "fiducials", 0, "number"), 2, "head: fiducial numbers must be unique"),
        (("head", "seating_error_mm"), -0.05, "head.seating_error_mm"),
        (("head", "fiducials", 0, "worn_percent"), 61.0, "head.fiducials 1.worn_percent"),
        (("head", "fiducials", 0, "base_in_theatre"), 9, r"base_in_theatre names unknown spheres: \[9\]"),
        (("head", "fiducials", 0, "base_in_theatre"), 2, "head: a base can be on one screw only"),
        (("head", "x_frame"), True, "head: the x-shaped frame has 4 spheres, not 3"),
        (
            ("head", "robot_from_patient_frame"),
            {"translation_mm": [800.0, 240.0, 140.0], "quaternion_wxyz": [1.0, 0.0, 0.0, 0.0]},
            "head.robot_from_patient_frame needs a tool with part number RONNA-P in tracker.tools",
        ),
        (("head", "centre_ct_mm"), [float("nan"), 0.0, 0.0], "head.centre_ct_mm 1"),
        (("mount", "tool_number_stereo"), 3, "mount.tool_number_stereo"),
        (("mount", "tool_number_guide"), 1, "mount: both tools have number 1"),
        (("tracker", "noise_z_mm"), float("inf"), "tracker.noise_z_mm"),
        (("tracker", "tools", 0, "markers_mm"), SPHERE_CENTRES_MM[:2], "tracker.tools 1.markers_mm: .*got 2"),
        (("tracker", "tools", 0, "markers_mm"), [*SPHERE_CENTRES_MM] * 6, "1.markers_mm: .*got 24"),
        (("tracker", "tools", 0, "markers_mm", 1), [1e39, 0.0, 0.0], "tracker.tools 1.markers_mm 2"),
        (("tracker", "tools", 0, "normal"), [0.0, 0.0, 0.0], "tracker.tools 1.normal"),
        (("tracker", "tools", 0, "name"), "../frame", "tracker.tools 1.name"),
        (("tracker", "tools", 0, "name"), "guide_frame", "tracker: tool names must be unique"),
        (("name",), "mini\x1b[2J", "name"),
        (("tracker", "tools", 0, "part_number"), "RONNA-µ", "tracker.tools 1.part_number"),
        (("head", "targets", 0, "identifier"), "../T1", "head.targets 1.identifier"),
        (("head", "targets", 0, "identifier"), "T\n1", "head.targets 1.identifier"),
        (("head", "targets", 0, "free_angle_deg"), 1e9, "head.targets 1.free_angle_deg"),
        (("head", "targets", 0, "margin_mm"), 0.0, "head.targets 1.margin_mm"),
        (
            ("head", "targets", 0, "entry_ct_mm"),
            draw_scene("mini").head.targets[0].target_ct_mm,
            "head.targets 1: entry_ct_mm and target_ct_mm are 0 mm apart",
        ),
        (("left", "serial"), draw_scene("mini").right.serial, "left.serial and right.serial are both"),
        (("left", "serial"), "", "left.serial"),
    ],
)
def test_an_impossible_scene_is_refused_and_the_field_named(
    path: tuple[str | int, ...], value: Any, said: str, tmp_path: Path
) -> None:
    content = json.loads(draw_scene("mini").model_dump_json(by_alias=True))
    place = content
    for part in path[:-1]:
        place = place[part]
    place[path[-1]] = value
    file = tmp_path / "scene.json"
    file.write_text(json.dumps(content))
    with raises(BAD_SCENE, match=f"SIM-001: .*{said}"):
        read_scene(file)


def test_a_scene_file_out_of_bounds_is_refused_by_its_name(tmp_path: Path) -> None:
    file = tmp_path / "theatre.json"
    file.write_text("[" * 200_000)
    with raises(BAD_SCENE, match=r"^SIM-001: theatre\.json is refused: "):
        read_scene(file)


def test_every_built_in_scene_is_read_back_unchanged_from_its_file(tmp_path: Path) -> None:
    for name in ("default", "mini", "bench"):
        file = tmp_path / "scene.json"
        file.write_text(draw_scene(name).model_dump_json(by_alias=True))
        assert read_scene(file) == draw_scene(name)


def test_a_frame_whose_spheres_do_not_match_its_layout_is_refused() -> None:
    content = json.loads(draw_scene("mini", fiducials=Carrier.XFRAME).model_dump_json(by_alias=True))
    content["head"]["fiducials"][1]["centre_ct_mm"][0] += 0.1
    with raises(BAD_SCENE, match="do not match the x-shaped frame"):
        parse_scene(content, "scene.json")


@pytest.mark.parametrize("seed", range(10))
def test_the_guide_has_clearance_from_the_frame(seed: int) -> None:
    head = draw_scene("default", seed=seed, fiducials=Carrier.XFRAME).head
    place, _ = Rotation.align_vectors(
        np.diff([one.centre_ct_mm for one in head.fiducials], axis=0), np.diff(SPHERE_CENTRES_MM, axis=0)
    )
    origin = np.array(head.fiducials[0].centre_ct_mm) - place.apply(SPHERE_CENTRES_MM[0])
    for target in head.targets:
        for body in bodies():
            along = np.linspace(place.apply(body.start_mm), place.apply(body.end_mm), 40) + origin
            apart = np.linalg.norm(np.cross(along - target.entry_ct_mm, target.outwards_ct), axis=1)
            assert apart.min() > 20.0


def test_the_patients_frame_changes_nothing_else_in_a_scene() -> None:
    plain, framed = draw_scene("mini", seed=5), add_patient_frame(draw_scene("mini", seed=5))
    assert framed.head.robot_from_patient_frame is not None
    assert [tool.name for tool in framed.tracker.tools[len(plain.tracker.tools) :]] == ["patient_frame"]
    head = framed.head.model_copy(update={"robot_from_patient_frame": None})
    tracker = framed.tracker.model_copy(update={"tools": plain.tracker.tools})
    assert framed.model_copy(update={"head": head, "tracker": tracker}) == plain
    assert add_patient_frame(framed) == framed


def test_a_bench_has_no_head_clamp_for_a_frame() -> None:
    with raises(BAD_SCENE, match="SIM-001: bench has no head"):
        add_patient_frame(draw_scene("bench"))
