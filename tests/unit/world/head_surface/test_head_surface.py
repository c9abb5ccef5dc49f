from functools import cache

import numpy as np
import pytest

from sim.world.head_surface.bare_bone import BareBone, HeadWithBareBone
from sim.world.head_surface.ellipsoidal_head import EllipsoidalHead
from sim.world.head_surface.face import Face, draw_measures
from sim.world.head_surface.parametric_head import ParametricHead
from sim.world.head_surface.regions import Region, above_hair_line_mm, hair_mm, hidden_by_hair, regions
from sim.world.head_surface.skin_shift import ShiftedHead, SkinShift
from sim.world.head_surface.skull_surface import SkullSurface
from sim.world.head_surface.surface import HeadSurface
from sim.world.rigid import Vectors
from sim.world.skull import SCALP_MM

CENTRE_MM = (3.2, -41.7, 812.4)
FAR_MM = 400.0
FACE_ON, FROM_LEFT, FROM_BEHIND = (0.0, -1.0, 0.0), (1.0, -0.2, 0.1), (0.3, 1.0, 0.2)


@cache
def drawn_head(seed: int, hair_mm: float = 0.0, hair_share: float = 0.0) -> ParametricHead:
    measures = draw_measures(np.random.default_rng(seed))
    face = measures.face.model_copy(update={"hair_mm": hair_mm, "hair_share": hair_share})
    return ParametricHead(CENTRE_MM, measures.semi_axes_mm, face)


def rays_from(direction: tuple[float, float, float], count: int = 60) -> tuple[Vectors, Vectors]:
    """Parallel rays through a square of 240 mm around the head."""
    back = np.array(direction) / np.linalg.norm(direction)
    across = np.cross((0.0, 0.0, 1.0), back)
    across /= np.linalg.norm(across)
    u, v = np.meshgrid(*2 * [np.linspace(-120.0, 120.0, count)])
    origins = (
        CENTRE_MM + FAR_MM * back + u.reshape(-1, 1) * across + v.reshape(-1, 1) * np.cross(back, across)
    )
    return origins, np.tile(-back, (len(origins), 1))


def skin_of(head: HeadSurface, *directions: tuple[float, float, float]) -> Vectors:
    found = []
    for direction in directions or (FACE_ON, FROM_LEFT, FROM_BEHIND):
        origins, along = rays_from(direction)
        hits = head.cast(origins, along, 2.0 * FAR_MM)
        found.append((origins + hits[:, None] * along)[np.isfinite(hits)])
    return np.vstack(found)


@pytest.mark.parametrize("seed", range(3))
def test_the_distance_near_the_skin_grows_by_the_way_along_the_normal(seed: int) -> None:
    head = drawn_head(seed)
    skin = skin_of(head)
    normals = head.normals(skin)
    for step_mm in (-1.0, -0.3, 0.3, 1.0):
        error = np.abs(head.distance_mm(skin + step_mm * normals) - step_mm)
        # Beside the nose and at the rim of an ear the skin bends within a few millimetres.
        assert np.quantile(error, 0.9) < 0.05 * abs(step_mm)
        assert np.quantile(error, 0.97) < 0.2 * abs(step_mm)


@pytest.mark.parametrize("direction", [FACE_ON, FROM_LEFT, FROM_BEHIND, (0.2, -0.7, -0.6)])
def test_rays_end_on_the_skin_and_pass_through_air_before(direction: tuple[float, float, float]) -> None:
    head = drawn_head(1)
    origins, along = rays_from(direction)
    hits = head.cast(origins, along, 2.0 * FAR_MM)
    met = np.isfinite(hits)
    assert 0.2 < met.mean() < 0.95
    assert np.abs(head.distance_mm((origins + hits[:, None] * along)[met])).max() < 2e-3
    for share in (0.9, 0.97, 0.995):
        assert (head.distance_mm((origins + share * hits[:, None] * along)[met]) > 0.0).all()


def test_a_ray_that_ends_before_the_head_meets_nothing() -> None:
    origins, along = rays_from(FACE_ON)
    assert np.isnan(drawn_head(1).cast(origins, along, 200.0)).all()


def test_normals_are_the_slope_of_the_distance() -> None:
    head = drawn_head(2)
    skin = skin_of(head, FACE_ON)
    slope = np.column_stack(
        [head.distance_mm(skin + step) - head.distance_mm(skin - step) for step in 0.01 * np.eye(3)]
    )
    slope /= np.linalg.norm(slope, axis=1, keepdims=True)
    assert np.quantile((slope * head.normals(skin)).sum(axis=1), 0.02) > 0.999


def test_equal_seeds_draw_equal_heads_of_adult_size() -> None:
    assert draw_measures(np.random.default_rng(5)) == draw_measures(np.random.default_rng(5))
    drawn = [draw_measures(np.random.default_rng(seed)) for seed in range(200)]
    breadths = np.array([2.0 * one.semi_axes_mm[0] for one in drawn])
    lengths = np.array([one.face.face_length_mm for one in drawn])
    assert breadths.mean() == pytest.approx(150.0, abs=2.0)
    assert 4.0 < breadths.std() < 8.0
    assert lengths.mean() == pytest.approx(118.0, abs=2.0)


def test_a_head_without_a_face_is_met_where_its_ellipsoid_is() -> None:
    head = EllipsoidalHead(CENTRE_MM, (75.0, 95.0, 90.0))
    skin = skin_of(head, FROM_LEFT)
    assert np.linalg.norm((skin - CENTRE_MM) / (75.0, 95.0, 90.0), axis=1) == pytest.approx(1.0, abs=1e-9)


def test_regions_have_the_names_of_the_places() -> None:
    head = drawn_head(0)
    marks, (a, _, c) = head.landmarks, head.semi_axes_mm
    places = {
        Region.NOSE: (0.0, -200.0, marks.nose_tip[2]),
        Region.FOREHEAD: (0.0, -200.0, marks.sellion_mm + 40.0),
        Region.JAW: (0.0, -200.0, marks.menton_mm + 14.0),
        Region.EYE: (marks.eye(head.face)[0], -200.0, marks.eye(head.face)[2]),
        Region.OCCIPUT: (0.0, 200.0, 0.0),
        Region.NECK: (0.0, 200.0, marks.menton_mm),
    }
    starts = np.array(list(places.values())) + CENTRE_MM
    inwards = np.column_stack(
        [np.zeros(len(starts)), -np.sign(starts[:, 1] - CENTRE_MM[1]), np.zeros(len(starts))]
    )
    skin = starts + head.cast(starts, inwards, FAR_MM)[:, None] * inwards
    assert regions(head, skin).tolist() == [str(name) for name in places]
    side, top = np.add(CENTRE_MM, (a, 0.0, 0.0)), np.add(CENTRE_MM, (0.0, 0.0, c))
    assert regions(head, np.array([top, side])).tolist() == ["vault", "vault"]
    ear = np.add(np.add(CENTRE_MM, marks.ear), (0.6 * head.face.ear_protrusion_mm, 20.0, 0.0))
    assert regions(head, ear[None]).tolist() == ["ear"]


def test_hair_hides_its_share_of_the_skin_behind_the_hair_line_alone() -> None:
    head = drawn_head(3, hair_mm=6.0, hair_share=0.7)
    skin = skin_of(head)
    hidden, height = hidden_by_hair(head, skin), above_hair_line_mm(head, skin)
    on_ear = regions(head, skin) == Region.EAR
    assert hidden[(height > 10.0) & ~on_ear].mean() == pytest.approx(0.7, abs=0.05)
    assert not hidden[height < 0.0].any()
    assert (hair_mm(head, skin)[height < 0.0] == 0.0).all()
    assert (hidden == hidden_by_hair(head, skin)).all()
    assert not hidden_by_hair(drawn_head(3), skin).any()


@pytest.mark.parametrize("order", [0.5, 1.5, 2.5])
def test_the_skin_moves_by_the_stated_size_over_the_stated_length(order: float) -> None:
    head = drawn_head(1)
    skin = skin_of(head, FACE_ON)[::7]
    beside = np.add(skin, (15.0, 0.0, 0.0))
    moved, moved_beside = [], []
    for seed in range(60):
        shifted = ShiftedHead(
            head, SkinShift(seed=seed, field_mm=0.5, field_length_mm=30.0, field_order=order)
        )
        moved.append(shifted.shift_mm(skin))
        moved_beside.append(shifted.shift_mm(beside))
    assert np.sqrt(np.mean(np.square(moved))) == pytest.approx(0.5, abs=0.06)
    # Matérn covariance at half the length
    expected = {0.5: np.exp(-0.5), 1.5: (1 + 0.75**0.5) * np.exp(-(0.75**0.5)), 2.5: 0.9}[order]
    assert np.mean(np.multiply(moved, moved_beside)) / 0.25 == pytest.approx(expected, abs=0.17)


def test_the_shifted_surface_is_the_skin_of_the_ct_plus_the_shift() -> None:
    head = drawn_head(1)
    shifted = ShiftedHead(head, SkinShift(seed=4, field_mm=0.5, pillow_mm=-2.0, jaw_mm=6.0))
    origins, along = rays_from(FROM_LEFT)
    hits = shifted.cast(origins, along, 2.0 * FAR_MM)
    places = (origins + hits[:, None] * along)[np.isfinite(hits)]
    assert head.distance_mm(places) == pytest.approx(shifted.shift_mm(places), abs=0.01)


@pytest.mark.parametrize(
    ("shift", "moved", "still"),
    [
        (SkinShift(pillow_mm=-2.0), Region.OCCIPUT, (Region.NOSE, Region.JAW, Region.FOREHEAD)),
        (SkinShift(tape_mm=2.0), Region.EYE, (Region.OCCIPUT, Region.VAULT, Region.NECK)),
        (SkinShift(jaw_mm=6.0), Region.JAW, (Region.OCCIPUT, Region.EYE, Region.FOREHEAD)),
        (SkinShift(pins_mm=-2.0), Region.VAULT, (Region.NOSE, Region.EYE, Region.JAW)),
    ],
)
def test_an_event_moves_the_skin_where_its_name_says(
    shift: SkinShift, moved: Region, still: tuple[Region, ...]
) -> None:
    head = drawn_head(0)
    skin = skin_of(head)
    names, by_mm = regions(head, skin), np.abs(ShiftedHead(head, shift).shift_mm(skin))
    assert by_mm[names == moved].max() > 1.0
    assert by_mm[np.isin(names, still)].max() < 0.5


def test_ears_folded_in_the_ct_stand_off_in_the_theatre() -> None:
    standing = drawn_head(0)
    folded = ParametricHead(
        CENTRE_MM, standing.semi_axes_mm, standing.face.model_copy(update={"ear_folds": (1.0, 0.0)})
    )
    on_ear = (0.7 * standing.face.ear_protrusion_mm, 19.0, 0.0)
    ear = np.add(np.add(CENTRE_MM, standing.landmarks.ear), on_ear)
    mirrored = np.add(ear * (-1.0, 1.0, 1.0), (2.0 * CENTRE_MM[0], 0.0, 0.0))
    assert standing.distance_mm(ear[None])[0] < 1.0
    assert folded.distance_mm(ear[None])[0] > 5.0
    assert folded.distance_mm(mirrored[None])[0] < 1.0
    unfolded = ShiftedHead(folded, SkinShift(ears_unfold=True))
    assert unfolded.distance_mm(ear[None]) == pytest.approx(standing.distance_mm(ear[None]))


def test_bare_bone_is_met_below_the_scalp_inside_the_opening_alone() -> None:
    head = drawn_head(0)
    top = np.add(CENTRE_MM, (0.0, 0.0, head.semi_axes_mm[2]))
    x, y, z = top.tolist()
    open_head = HeadWithBareBone(head, SkullSurface(head), BareBone(centre_ct_mm=(x, y, z), radius_mm=30.0))
    starts = top + np.array([[0.0, 0.0, 50.0], [10.0, 0.0, 50.0], [45.0, 0.0, 50.0]])
    down = np.tile((0.0, 0.0, -1.0), (3, 1))
    closed, opened = (one.cast(starts, down, FAR_MM) for one in (head, open_head))
    assert (opened - closed)[:2] == pytest.approx(SCALP_MM, abs=0.1)
    assert opened[2] == closed[2]
    places = starts + opened[:, None] * down
    assert open_head.shows_bone(places).tolist() == [True, True, False]
    assert np.abs(open_head.distance_mm(places)).max() < 2e-3


def test_the_face_of_the_defaults_is_a_face() -> None:
    head = ParametricHead(CENTRE_MM, (76.0, 97.0, 90.0), Face())
    assert set(regions(head, skin_of(head))) >= {str(name) for name in Region}
