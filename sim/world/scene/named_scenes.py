"""Named scenes: `default`, `mini`, `bench` and `bench-near`, each drawn from a seed.

The room: the robot's base is the origin, x forward, z up. The patient is semi-reclined, the vertex up and
towards the robot; the tracker views the head from above and the side.
"""

from __future__ import annotations

from math import ceil, radians

import numpy as np

from ronna_hw import patient_frame
from ronna_hw.arm.catalogue import ArmChoice
from ronna_hw.marker_template import MarkerTemplate
from ronna_hw.near_names import did_you_mean
from ronna_hw.x_frame import NAME as X_FRAME_NAME
from ronna_hw.x_frame import OUTWARD, SPHERE_CENTRES_MM
from ronna_hw.x_frame import PART_NUMBER as X_FRAME_PART_NUMBER
from sim.errors import BAD_SCENE
from sim.world.head_surface.face import draw_measures
from sim.world.head_surface.skin_shift import draw_shift
from sim.world.noise import noise
from sim.world.options import Carrier
from sim.world.rigid import Point, apply, as_point, matrix_from, matrix_of, pose_of, rotation_towards
from sim.world.scene.arm_design import CHOSEN
from sim.world.scene.as_built import draw_arm, draw_cameras, draw_mount, draw_projector
from sim.world.scene.head import draw_head
from sim.world.scene.model import CtProtocol, Scene, Stand, TrackerTool, TrackerTruth
from sim.world.scene.parts import (
    GUIDE_FRAME_IN_TIP,
    GUIDE_FRAME_MARKERS_MM,
    GUIDE_FRAME_NAME,
    GUIDE_FRAME_PART_NUMBER,
    Guide,
)

SCENES = ("default", "mini", "bench", "bench-near")
MINI_CT = CtProtocol(pixel_mm=1.0, slice_mm=1.5, columns=256, rows=256, slices=134, noise_HU=20.0)
MINI_AREA_PX = (800, 800)
HEAD_AND_CHIN_MM = 261.0  # field of a CT of head and face along its slices
# Markers by the kind of fiducials, the usual number last
MARKERS_ON_SKIN = {Carrier.SURFACE: (0,), Carrier.MIXED: (1, 3, 2)}
# The tracker must see the head and, with the arm at home, the reference frame M half a metre above it.
MARKER_FROM_HEAD_MM = (-150.0, 0.0, 500.0)
TRACKER_DIRECTION = (500.0, 900.0, 1300.0)
TRACKER_DISTANCE_MM = 1900.0  # from the midpoint of head and frame
# On an arm of the head clamp, level with the ear on the tracker's side: the staff turn it to the tracker.
FRAME_BESIDE_HEAD_MM = (60.0, 230.0, -60.0)  # from the centre of the head, along the robot's axes
# Four markers whose six distances differ by at least 4 mm, so that the pose is unique.
ROBOT_FRAME_MARKERS_MM = ((0.0, 0.0, 0.0), (45.0, 60.0, 0.0), (-30.0, 85.0, 0.0), (-62.0, 30.0, 12.0))
USUAL_REFLECTIONS = 2  # in a room with lamps and instruments
# Staff place the stand by hand, its dials aligned with the robot's axes by eye.
STAND_FROM_HEAD_MM = (-197.0, -325.0, 30.0)  # of the middle of the places of the head's centre
STAND_SPREAD_MM = 3.0
DIVOT_MM = 0.005  # manufacturing tolerance per axis
DIALS_RAD = radians(1.0)
# Distance of the tools on a tracker's bench; `bench-near` is within the volume of a Polaris Vicra.
BENCH_DISTANCES_MM = {"bench": 1500.0, "bench-near": 1230.0}


def draw_scene(
    name: str,
    *,
    seed: int = 0,
    markers: int | None = None,
    targets: int | None = None,
    template: MarkerTemplate | None = None,
    fiducials: Carrier = Carrier.FREE,
    arm: ArmChoice = ArmChoice.KR6,
) -> Scene:
    """Draw a named scene; raises SIM-001 for an unknown name.

    The default scene has 5 markers and 3 targets, the mini scene 3 and 1. The x-shaped frame has four markers
    and is a tool of the tracker. With the skin as fiducial the head has a face, a skin that moved, no markers
    or 1 to 3 (`mixed`; 2 by default), the patient's frame on its clamp, and the stereo head a line projector.
    """
    if name not in SCENES:
        raise BAD_SCENE(
            f"unknown scene {name!r}", expected=", ".join(SCENES), action=did_you_mean(name, SCENES) or None
        )
    x_frame, on_skin = fiducials is Carrier.XFRAME, fiducials in MARKERS_ON_SKIN
    if x_frame and markers not in (None, len(SPHERE_CENTRES_MM)):
        raise BAD_SCENE(f"the x-shaped frame has {len(SPHERE_CENTRES_MM)} markers, not {markers}")
    mini = name == "mini"
    usual = MARKERS_ON_SKIN[fiducials][-1] if on_skin else 3 if mini else 5
    count = usual if markers is None else markers
    if on_skin and count not in MARKERS_ON_SKIN[fiducials]:
        fitting = " or ".join(str(one) for one in sorted(MARKERS_ON_SKIN[fiducials]) if one) or "no"
        raise BAD_SCENE(f"with fiducials {fiducials} a head carries {fitting} markers, not {count}")
    generator = scene_generator(seed)
    design = CHOSEN[arm]
    head = draw_head(
        generator,
        count,
        (1 if mini else 3) if targets is None else targets,
        template,
        x_frame=x_frame,
        arm=design,
        measures=draw_measures(noise(seed, "face", 0)) if on_skin else None,
    ).head
    if on_skin:
        head = head.model_copy(update={"skin_shift": draw_shift(noise(seed, "skin shift", 0))})
    left, right = draw_cameras(generator)
    true_arm, mount = draw_arm(generator, design), draw_mount(generator)
    on_bench = name in BENCH_DISTANCES_MM
    if not on_bench:
        mount = mount.model_copy(update={"guide": Guide(tip_from_frame=GUIDE_FRAME_IN_TIP)})
    protocol = MINI_CT if mini else CtProtocol()
    if on_skin:
        protocol = whole_head(protocol)
    scene = Scene(
        name=name,
        seed=seed,
        head=head,
        ct=protocol,
        arm=true_arm,
        mount=mount,
        tracker=_place_bench_tracker(BENCH_DISTANCES_MM[name])
        if on_bench
        else _place_tracker(
            apply(matrix_of(head.robot_from_ct), head.centre_ct_mm),
            0 if mini else USUAL_REFLECTIONS,
            (robot_frame(), *((frame_on_head(),) if x_frame else ()), frame_on_guide()),
        ),
        projector=draw_projector(seed) if on_skin else None,
        left=left,
        right=right,
        stand=_draw_stand(seed, design.head_mm),
        servo_area_px=MINI_AREA_PX if mini else (1024, 1024),
    )
    return add_patient_frame(scene) if on_skin and not on_bench else scene


def whole_head(protocol: CtProtocol) -> CtProtocol:
    """Return the protocol with as many slices as head and chin need."""
    return protocol.model_copy(update={"slices": ceil(HEAD_AND_CHIN_MM / protocol.slice_mm)})


def scene_generator(seed: int) -> np.random.Generator:
    """Return the random numbers of a scene; its head is drawn first."""
    return np.random.Generator(np.random.Philox(key=seed))


def _draw_stand(seed: int, head_mm: Point) -> Stand:
    """Draw the stand with independent noise, so that it does not affect the rest of the scene."""
    generator = noise(seed, "stand", 0)
    return Stand(
        ball_mm=as_point(
            np.add(head_mm, STAND_FROM_HEAD_MM) + generator.uniform(-STAND_SPREAD_MM, STAND_SPREAD_MM, 3)
        ),
        divot_from_ball_mm=as_point(generator.normal(0.0, DIVOT_MM, 3)),
        dials_turned_rad=as_point(generator.normal(0.0, DIALS_RAD, 3)),
    )


def robot_frame() -> TrackerTool:
    """Return the reference frame M on the mount, as a tracker tool."""
    return TrackerTool(name="robot_frame", part_number="RONNA-M", markers_mm=ROBOT_FRAME_MARKERS_MM)


def frame_on_head() -> TrackerTool:
    """Return the x-shaped frame as a tracker tool."""
    return TrackerTool(
        name=X_FRAME_NAME, part_number=X_FRAME_PART_NUMBER, markers_mm=SPHERE_CENTRES_MM, normal=OUTWARD
    )


def frame_on_guide() -> TrackerTool:
    """Return the guide's frame as a tracker tool, which identifies the mounted tool."""
    return TrackerTool(
        name=GUIDE_FRAME_NAME, part_number=GUIDE_FRAME_PART_NUMBER, markers_mm=GUIDE_FRAME_MARKERS_MM
    )


def add_patient_frame(scene: Scene) -> Scene:
    """Return the scene with the patient's frame on the head clamp; raises SIM-001 without a head in view.

    Nothing is drawn at random, so everything else stays as it is.
    """
    if not scene.tracker.fiducials_visible:
        raise BAD_SCENE(f"{scene.name} has no head: the patient's frame is on its clamp")
    centre = apply(matrix_of(scene.head.robot_from_ct), scene.head.centre_ct_mm)
    place = centre + np.array(FRAME_BESIDE_HEAD_MM)
    to_tracker = np.array(scene.tracker.robot_from_tracker.translation_mm) - place
    pose = pose_of(matrix_from(place, rotation_towards(to_tracker / np.linalg.norm(to_tracker), (1, 0, 0))))
    head = scene.head.model_copy(update={"robot_from_patient_frame": pose})
    tools = tuple(one for one in scene.tracker.tools if one.part_number != patient_frame.PART_NUMBER)
    tracker = scene.tracker.model_copy(update={"tools": (*tools, frame_on_clamp())})
    return scene.model_copy(update={"head": head, "tracker": tracker})


def frame_on_clamp() -> TrackerTool:
    """Return the patient's frame as a tracker tool."""
    return TrackerTool(
        name=patient_frame.NAME,
        part_number=patient_frame.PART_NUMBER,
        markers_mm=patient_frame.MARKERS_MM,
    )


def _place_tracker(
    head_centre_mm: np.ndarray, reflections: int, tools: tuple[TrackerTool, ...]
) -> TrackerTruth:
    span = np.array(MARKER_FROM_HEAD_MM)
    backwards = np.array(TRACKER_DIRECTION) / np.linalg.norm(TRACKER_DIRECTION)
    position = head_centre_mm + span / 2 + backwards * TRACKER_DISTANCE_MM
    # z points backwards, away from the head; the housing's long axis y lies along head and frame.
    rotation = rotation_towards(backwards, np.cross(span, backwards))
    pose = pose_of(matrix_from(position, rotation))
    return TrackerTruth(robot_from_tracker=pose, tools=tools, reflections=reflections)


def _place_bench_tracker(distance_mm: float) -> TrackerTruth:
    pose = pose_of(matrix_from((distance_mm, 0.0, 0.0), rotation_towards((1, 0, 0), (0, 0, 1))))
    places = tuple(
        pose_of(matrix_from((x, y, -distance_mm), np.eye(3)))
        for x in (-150.0, 150.0)
        for y in (-300.0, -100.0, 100.0, 300.0)
    )
    strays = (
        (0.0, -200.0, 100.0 - distance_mm),
        (20.0, 0.0, -100.0 - distance_mm),
        (-20.0, 200.0, -distance_mm),
    )
    return TrackerTruth(
        robot_from_tracker=pose,
        tools=(robot_frame(),),
        places=places,
        strays_mm=strays,
        line_separation_mm=0.0,
        fiducials_visible=False,
    )
