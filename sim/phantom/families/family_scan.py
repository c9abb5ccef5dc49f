"""Random scan from a family: head, markers, surroundings and field of view."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import replace
from math import pi, radians
from typing import Any

import numpy as np

from ronna_hw.near_names import did_you_mean
from sim.errors import BAD_SCENE, SEE_PHANTOM
from sim.phantom.families.catalogue import (
    FAMILIES,
    PAIR_DISTANCE_MM,
    PROTOCOLS,
    Family,
    Headrest,
    MetalBases,
    draw_bands,
)
from sim.phantom.head import obstacles
from sim.phantom.head.anatomy import (
    CABLE_BEHIND_MM,
    CABLE_GAP_MM,
    SPHERE_HU,
    Anatomy,
    SkinMarker,
    bare_marker,
    jaw_teeth,
    marker_on_metal,
    marker_on_post,
    shift_point,
    side_cable,
    sinuses,
    trough,
    ventricles,
)
from sim.phantom.head.look_alikes import LookAlike, PlacedOn
from sim.phantom.head.obstacles import (
    FRAMES,
    FREE,
    SPHERES,
    Obstacles,
    frame_fiducials,
    frame_markers,
    frame_shapes,
    skin_point,
)
from sim.phantom.head.painting import Streak
from sim.phantom.head.shapes import ellipsoid_depth
from sim.phantom.scan import Scan
from sim.phantom.scanner.faults import NO_FAULTS, ScannerFaults
from sim.phantom.scanner.grid import CtGrid, grid_ending_at_spheres, place_grid
from sim.world.noise import noise
from sim.world.rigid import Vector, as_rounded_point
from sim.world.scene.head import CAP_AXIS_CT, CENTRE_CT_MM, draw_direction
from sim.world.scene.model import CtProtocol, Fiducial, Head, Scene
from sim.world.scene.named_scenes import draw_scene
from sim.world.scene.parts import Target

LARGEST_MARKERS = 8
CAP_HALF_ANGLE_RAD = radians(60.0)
BESIDE_FRAME_RAD = radians(80.0)  # the frame occupies the middle of the cap
CLEARANCE_MM = 26.0  # between markers, and from them to other things on the head
SHORT_CLEARANCE_MM = 18.0  # to electrodes and bolts
CABLE_ROOM_MM = 22.0  # it swings by 6 mm, and a pair is 14 mm long
LEAD_ROOM_MM = 8.0  # between a sphere's centre and a lead
LOOK_ALIKES_OF_A_KIND = 2
LOOK_ALIKE_ROOM_MM, LOOK_ALIKE_HEIGHT_MM = 44.0, 20.0  # a 30 mm rod touches nothing else
LOOK_ALIKE_MARGIN_MM = 12.0  # to the end of the field
TARGET_DEPTH_MM = 50.0
ATTEMPTS = 4000
STREAK_BELOW_MM = 9.75  # from the sphere's centre down its post
STREAK_HEIGHT_MM = 3.0


def family_scan(
    name: str, protocol: str, *, seed: int = 0, markers: int | None = None, fiducials: str = FREE
) -> Scan:
    """Draw a scan; raises SIM-001 if the name is unknown or the markers do not fit."""
    if name not in FAMILIES:
        raise BAD_SCENE(
            f"unknown family {name!r}",
            expected=", ".join(FAMILIES),
            action=f"{did_you_mean(name, FAMILIES)} {SEE_PHANTOM}".lstrip(),
        )
    if fiducials in FRAMES and markers is not None and not SPHERES <= markers <= LARGEST_MARKERS:
        raise BAD_SCENE(f"the x-shaped frame has {SPHERES} spheres: {SPHERES} to {LARGEST_MARKERS} markers")
    family, generator = FAMILIES[name], noise(seed, f"family {name}", 0)
    count = markers or (SPHERES if fiducials in FRAMES else family.markers)
    drawing = _Drawing(family, generator)
    head, sphere_centres = drawing.draw_head(seed, count, fiducials)
    scene = _build_scene(family, protocol, seed, head, fiducials)
    covering_mm = 0.0 if family.bandage_mm is None else float(generator.uniform(*family.bandage_mm))
    around, distractors = drawing.draw_obstacles(head, sphere_centres, covering_mm)
    grid, marks = place_grid(head, scene.ct), _compute_burial_shares(head, covering_mm)
    objects = drawing.draw_look_alikes(head, grid, sphere_centres)
    if family.bare:
        built = tuple(bare_marker(fiducial, generator) for fiducial in head.fiducials)
    elif family.bases is not None:
        built, beside = drawing.draw_metal(head, family.bases)
        around += beside
    elif fiducials in FRAMES:
        built = frame_markers(head, generator)
    else:
        built = tuple(marker_on_post(fiducial, head, generator) for fiducial in head.fiducials)
    anatomy = drawing.draw_anatomy(head, built, around, fiducials)
    if objects:
        bodies = tuple(shape for one in objects for shape in one.shapes)
        places = tuple(place for one in objects for place in one.places)
        anatomy = replace(anatomy, surroundings=(*anatomy.surroundings, *bodies), deceiving=places)
    if family.edge:
        grid, shares = grid_ending_at_spheres(grid, head, generator)
        for number, share in shares.items():
            marks.setdefault(number, {})["surface_in_field"] = share
    truth: dict[str, Any] = {
        "family": name,
        "purpose": family.purpose.value,
        "protocol": protocol,
        "distractors_mm": [list(point) for point in distractors],
    }
    if objects:
        truth["look_alikes"] = [
            {"kind": one.kind, "places_mm": [list(place) for place in one.places]} for one in objects
        ]
    faults = NO_FAULTS
    if family.bases is not None:
        faults = ScannerFaults(kernel=str(generator.choice(family.bases.kernels)), metal_artefacts=True)
    return Scan(scene, grid, anatomy, fiducials, truth, marks, faults)


def protocol_named(name: str) -> CtProtocol:
    """Return a protocol by name; raises SIM-001 for an unknown name."""
    if name not in PROTOCOLS:
        raise BAD_SCENE(
            f"unknown protocol {name!r}",
            expected=", ".join(PROTOCOLS),
            action=f"{did_you_mean(name, PROTOCOLS)} {SEE_PHANTOM}".lstrip(),
        )
    return PROTOCOLS[name]


def _build_scene(family: Family, protocol: str, seed: int, head: Head, fiducials: str) -> Scene:
    words = [family.name, protocol] + ([fiducials] if fiducials != FREE else [])
    room = draw_scene("default", seed=seed)
    return room.model_copy(update={"name": "-".join(words), "head": head, "ct": protocol_named(protocol)})


def _number_fiducials(places: Iterable[tuple[Vector, Vector]], first: int) -> tuple[Fiducial, ...]:
    return tuple(
        Fiducial(number=number, centre_ct_mm=as_rounded_point(centre), post_ct=as_rounded_point(post))
        for number, (centre, post) in enumerate(places, first)
    )


def _distance_to_segment_mm(point: Vector, start: Vector, end: Vector) -> float:
    along_segment = end - start
    share = np.clip((point - start) @ along_segment / (along_segment @ along_segment), 0.0, 1.0)
    return float(np.linalg.norm(point - start - share * along_segment))


def _is_clear_of_spheres(bodies: Obstacles, centres: Vector) -> bool:
    x, y, z = centres.T.astype(np.float32)
    return all(float(shape.depth(x, y, z).max()) < -LEAD_ROOM_MM for shape in bodies.shapes)


def _is_clear_of_cable(centre: Vector, head: Head) -> bool:
    x, y, _ = head.centre_ct_mm
    cable = np.array([x + head.semi_axes_mm[0] + CABLE_GAP_MM, y + CABLE_BEHIND_MM])
    return bool(np.linalg.norm(centre[:2] - cable) > CABLE_ROOM_MM)


def _compute_burial_shares(head: Head, covering_mm: float) -> dict[int, dict[str, float]]:
    """Return the buried fraction of each sphere's height under a bandage."""
    if covering_mm <= 0.0:
        return {}
    marks = {}
    for fiducial in head.fiducials:
        x, y, z = (np.array([value], dtype=np.float32) for value in fiducial.centre_ct_mm)
        above_mm = -float(ellipsoid_depth(x, y, z, head.centre_ct_mm, head.semi_axes_mm)[0])
        buried_mm = covering_mm - above_mm + fiducial.radius_mm
        share = min(max(buried_mm / (2.0 * fiducial.radius_mm), 0.0), 1.0)
        marks[fiducial.number] = {"buried_share": round(share, 3)}
    return marks


class _Drawing:
    """Draws the parts of a family's scan; what is drawn depends on the order of the calls."""

    def __init__(self, family: Family, generator: np.random.Generator) -> None:
        self.family, self.random = family, generator

    def draw_metal(self, head: Head, kind: MetalBases) -> tuple[tuple[SkinMarker, ...], Obstacles]:
        """Draw the markers of a head on metal screws, and the metal beside them."""
        markers, around = [], Obstacles()
        for fiducial in head.fiducials:
            radius_mm, flange_mm, sphere_hu = (
                float(self.random.uniform(*one)) for one in (kind.radius_mm, kind.flange_mm, SPHERE_HU)
            )
            post_hu = float(self.random.choice(kind.hu))
            markers.append(marker_on_metal(fiducial, head, post_hu, radius_mm, flange_mm, sphere_hu))
            if self.random.uniform() < kind.beside:
                apart_mm = float(self.random.uniform(*kind.beside_mm))
                hu = float(self.random.choice(kind.hu))
                around += obstacles.metal_beside(fiducial, head, apart_mm, hu, self.random)
        return tuple(markers), around

    def draw_head(self, seed: int, count: int, fiducials: str) -> tuple[Head, Vector]:
        """Draw a head with markers, and return it with the marker centres (n, 3)."""
        sizes = (self.family.half_width_mm, self.family.half_depth_mm, self.family.half_height_mm)
        width, depth, height = (float(self.random.uniform(*size)) for size in sizes)
        along = np.array(CAP_AXIS_CT) / np.linalg.norm(CAP_AXIS_CT)
        bare = draw_scene("default", seed=seed).head.model_copy(
            update={"centre_ct_mm": CENTRE_CT_MM, "semi_axes_mm": (width, depth, height)}
        )
        entry, normal = skin_point(bare, along)
        target = Target(
            identifier="T1",
            entry_ct_mm=as_rounded_point(entry),
            target_ct_mm=as_rounded_point(entry - TARGET_DEPTH_MM * normal),
        )
        found = (
            self._draw_frame_and_more(bare, fiducials, count)
            if fiducials in FRAMES
            else self._draw_free_fiducials(bare, count)
        )
        head = bare.model_copy(update={"fiducials": found, "targets": (target,)})
        return head, np.array([fiducial.centre_ct_mm for fiducial in found])

    def _draw_free_fiducials(self, head: Head, count: int) -> tuple[Fiducial, ...]:
        pairs = self.family.pairs
        least = max(2 * pairs, 1)
        if not least <= count <= LARGEST_MARKERS:
            raise BAD_SCENE(f"a head of this family carries {least} to {LARGEST_MARKERS} markers")
        room_mm = CLEARANCE_MM + (PAIR_DISTANCE_MM if pairs else 0.0)
        places = self._draw_places(head, count - pairs, room_mm, CAP_HALF_ANGLE_RAD)
        if places is None:
            raise BAD_SCENE(f"{count} markers do not fit on the head")
        for centre, post in places[:pairs]:
            side = np.cross(post, self.random.standard_normal(3))
            places.append((centre + PAIR_DISTANCE_MM * side / np.linalg.norm(side), post))
        return _number_fiducials(places, 1)

    def _draw_frame_and_more(self, head: Head, frame: str, count: int) -> tuple[Fiducial, ...]:
        """Place the frame's spheres, plus any additional spheres next to the frame."""
        found = frame_fiducials(head, frame, self.random)
        centres = [np.array(one.centre_ct_mm) for one in found]
        bars = ((centres[0], centres[2]), (centres[1], centres[3]))
        places = self._draw_places(head, count - SPHERES, CLEARANCE_MM, BESIDE_FRAME_RAD, centres, bars)
        if places is None:
            raise BAD_SCENE(f"{count - SPHERES} markers do not fit next to the frame")
        return (*found, *_number_fiducials(places, SPHERES + 1))

    def _draw_places(
        self,
        head: Head,
        count: int,
        room_mm: float,
        half_angle_rad: float,
        others: Sequence[Vector] = (),
        bars: Iterable[tuple[Vector, Vector]] = (),
    ) -> list[tuple[Vector, Vector]] | None:
        """Draw centres with posts, clear of cable, bars and each other; return None if they do not fit."""
        places: list[tuple[Vector, Vector]] = []
        centres = list(others)
        for _ in range(ATTEMPTS):
            if len(places) == count:
                return places
            skin, normal = skin_point(head, self._draw_cap_direction(half_angle_rad))
            centre = skin + normal * self.random.uniform(*self.family.standoff_mm)
            if (
                _is_clear_of_cable(centre, head)
                and all(np.linalg.norm(centre - other) > room_mm for other in centres)
                and all(_distance_to_segment_mm(centre, *bar) > CLEARANCE_MM for bar in bars)
            ):
                centres.append(centre)
                places.append((centre, normal))
        return None

    def draw_obstacles(
        self, head: Head, sphere_centres: Vector, covering_mm: float
    ) -> tuple[Obstacles, list[tuple[float, float, float]]]:
        """Draw the objects around the head, and return them with the distractor centres."""
        around = Obstacles()
        if covering_mm > 0.0:
            around += obstacles.bandage(
                head, covering_mm, float(self.random.uniform(*self.family.bandage_hu))
            )
        if self.family.headrest is Headrest.CUSHION:
            around += obstacles.cushion(head)
        if self.family.pins:
            around += obstacles.clamp(head, self.family.pins, self.random)
        occupied_points = [skin_point(head, centre - head.centre_ct_mm)[0] for centre in sphere_centres]
        for number in range(self.family.electrodes + self.family.bolts):
            fixed = obstacles.electrode if number < self.family.electrodes else obstacles.bolt
            for _ in range(ATTEMPTS):
                direction = self._find_free_direction(head, occupied_points, SHORT_CLEARANCE_MM, 0.0)
                if _is_clear_of_spheres(fixed(head, direction), sphere_centres):
                    break
            around += fixed(head, direction)
            occupied_points.append(skin_point(head, direction)[0])
        occupied_points = list(sphere_centres)
        distractors = []
        for number in range(2 * self.family.distractors):
            # far enough for the longest cylinder
            direction = self._find_free_direction(
                head, occupied_points, 1.4 * CLEARANCE_MM, 25.0, cap_rad=pi / 2
            )
            shape, middle = obstacles.distractor(head, direction, bool(number % 2), self.random)
            around += Obstacles((shape,))
            distractors.append(middle)
            occupied_points.append(np.array(middle))
        return around, distractors

    def draw_look_alikes(self, head: Head, grid: CtGrid, sphere_centres: Vector) -> list[LookAlike]:
        """Draw look-alikes within the field of view, clear of the markers and each other."""
        first = np.array(grid.origin_mm) + LOOK_ALIKE_MARGIN_MM
        last = np.array([grid.x_mm[-1], grid.y_mm[-1], grid.z_mm[-1]]) - LOOK_ALIKE_MARGIN_MM
        occupied_points = list(sphere_centres)
        drawn = []
        for draw in self.family.look_alikes * LOOK_ALIKES_OF_A_KIND:
            for _ in range(ATTEMPTS):
                direction = self._find_free_direction(
                    head, occupied_points, LOOK_ALIKE_ROOM_MM, LOOK_ALIKE_HEIGHT_MM, cap_rad=pi / 2
                )
                skin, normal = skin_point(head, direction)
                drawn_one = draw(PlacedOn(skin, normal, self.random))
                if all((first < place).all() and (place < last).all() for place in drawn_one.places):
                    break
            else:
                raise BAD_SCENE("the objects of this family do not fit in the CT's field of view")
            drawn.append(drawn_one)
            occupied_points.append(skin + LOOK_ALIKE_HEIGHT_MM * normal)
        return drawn

    def draw_anatomy(
        self, head: Head, markers: tuple[SkinMarker, ...], around: Obstacles, fiducials: str
    ) -> Anatomy:
        low, high = self.family.fillings
        teeth, fillings = jaw_teeth(head, self.random, int(self.random.integers(low, high + 1)))
        inside = (*ventricles(head), *sinuses(head), *teeth, *fillings)
        cable = side_cable(head) if self.family.cable else ()
        frame = frame_shapes(head, fiducials, self.random) if fiducials in FRAMES else ()
        return Anatomy(
            headrest=trough(head) if self.family.headrest is Headrest.TROUGH else (),
            surroundings=(*cable, *inside, *around.shapes, *frame),
            markers=markers,
            fillings=fillings,
            streaks=around.streaks + self._draw_post_streaks(markers),
            bands=draw_bands(self.family.bands, markers, self.random),
        )

    def _draw_post_streaks(self, markers: tuple[SkinMarker, ...]) -> tuple[Streak, ...]:
        kind = self.family.post_streaks
        if kind is None:
            return ()
        return tuple(
            Streak(
                shift_point(marker.fiducial.centre_ct_mm, marker.fiducial.post_ct, -STREAK_BELOW_MM),
                float(self.random.uniform(*kind.hu)),
                float(self.random.uniform(*kind.fall_mm)),
                int(self.random.choice(kind.lobes)),
                float(self.random.uniform(0.0, 2.0 * pi)),
                STREAK_HEIGHT_MM,
            )
            for marker in markers
        )

    def _draw_cap_direction(self, half_angle_rad: float = CAP_HALF_ANGLE_RAD) -> Vector:
        return draw_direction(self.random, np.array(CAP_AXIS_CT), half_angle_rad)

    def _find_free_direction(
        self,
        head: Head,
        occupied_points: list[Vector],
        clearance_mm: float,
        standoff_mm: float,
        cap_rad: float = CAP_HALF_ANGLE_RAD,
    ) -> Vector:
        for _ in range(ATTEMPTS):
            direction = self._draw_cap_direction(cap_rad)
            skin, normal = skin_point(head, direction)
            place = skin + standoff_mm * normal
            if all(np.linalg.norm(place - other) > clearance_mm for other in occupied_points):
                return direction
        raise BAD_SCENE("no room left on the head")
