"""The study of registrations on the skin: what is scanned, how it is displaced, judged and exported."""

from __future__ import annotations

import functools
import json
from dataclasses import asdict, replace
from pathlib import Path

import numpy as np
import pytest
from scipy.spatial.transform import RigidTransform

from ronna_hw.frames import Frame, Transform
from sim.world.head_surface.regions import Region, regions
from studies.campaign.study import Unit, add_up
from studies.surface import tables
from studies.surface.conditions import (
    DEVELOPMENT,
    FIRST_JUDGED,
    JUDGED,
    SECOND_JUDGED,
    SHIFTED,
    SIZE_MM,
    THIRD_JUDGED,
    Coverage,
    Draw,
    Skin,
)
from studies.surface.export import export_study
from studies.surface.heads import draw_head
from studies.surface.kinds import Kinds
from studies.surface.outcomes import Outcome, read_outcomes, share_within
from studies.surface.scanning import Trial, _draw_start, draw_trial
from studies.surface.second_judged_skins import BLUR_RATIOS, draw_blur
from studies.surface.skins import displace, shift_third
from studies.surface.study import SurfaceStudy, draw_unit

SEED = 5
DRAW = Draw(size_mm=0.4, length_mm=20.0, offset_sd_mm=0.0, offset_mm=0.0, noise_mm=0.05)


def scan(coverage: Coverage, skin: Skin = Skin.RIGID) -> Trial:
    return draw_trial(draw_head(SEED, 0), coverage, skin, DRAW, np.random.default_rng(3), shifted=False)


def in_ct(trial: Trial) -> np.ndarray:
    return np.asarray(trial.truth.inverse().apply(trial.scan.points_mm))


def test_a_scan_without_misfit_lies_on_the_skin_but_for_its_noise_and_few_strays() -> None:
    distances = np.abs(draw_head(SEED, 0).head.distance_mm(in_ct(scan(Coverage.FACE))))
    assert np.median(distances) < DRAW.noise_mm
    assert np.mean(distances > 6.0 * DRAW.noise_mm) < 0.05


def test_a_scan_of_the_face_shows_nothing_of_the_back_and_one_of_the_vault_nothing_of_the_face() -> None:
    assert in_ct(scan(Coverage.FACE))[:, 1].max() < 40.0
    assert np.quantile(in_ct(scan(Coverage.VAULT))[:, 2], 0.05) > -40.0


def test_a_hat_of_hair_hides_the_skin_of_the_vault() -> None:
    head, places = draw_head(SEED, 0).head, in_ct(scan(Coverage.HAIR))
    vault = places[places[:, 2] > 50.0]
    on_skin = np.abs(head.distance_mm(vault)) < 0.5
    assert on_skin.mean() < 0.3


@pytest.mark.parametrize("skin", [Skin.ROUGH, Skin.SMOOTH, Skin.SMOOTHEST, Skin.SWELLING])
def test_the_misfit_of_a_field_has_its_stated_size(skin: Skin) -> None:
    head = draw_head(SEED, 0)
    points = head.skin_mm[::40]
    moved = [displace(skin, head.head, points, DRAW, np.random.default_rng(k)) for k in range(60)]
    assert np.sqrt(np.mean(np.square(moved))) == pytest.approx(DRAW.size_mm, rel=0.35)


@pytest.mark.parametrize("skin", [Skin.PATCHES, Skin.TAPE, Skin.PILLOW])
def test_an_event_displaces_a_part_of_the_skin_only(skin: Skin) -> None:
    head = draw_head(SEED, 0)
    moved = [
        np.abs(displace(skin, head.head, head.skin_mm[::40], DRAW, np.random.default_rng(k)))
        for k in range(20)
    ]
    assert np.mean(moved) < 0.5 * np.max(moved)
    assert np.max(moved) > DRAW.size_mm


SHIFTED_BY: dict[Skin, tuple[float, float]] = {  # rms over the front and the ears, relative to the drawn size
    Skin.SAG: (0.55, 0.85),
    Skin.OEDEMA: (0.35, 0.7),
    Skin.SLICES: (0.5, 0.9),
    Skin.SCALE: (0.3, 0.5),
    Skin.BAND: (0.55, 0.8),
    Skin.FOLDS: (0.6, 0.8),
    Skin.PADS: (0.4, 0.65),
    Skin.HYDRATION: (0.4, 0.65),
    Skin.SLIDE: (0.4, 0.65),
    Skin.BLUR: (0.4, 0.65),
    Skin.TUBE: (0.4, 0.65),
    Skin.BEARD: (0.4, 0.75),
    Skin.WHEALS: (0.4, 0.65),
    Skin.STEROIDS: (0.4, 0.65),
    Skin.FLUID: (0.4, 0.65),
    Skin.FILM: (0.4, 0.65),
    Skin.STREAKS: (0.4, 0.7),
    Skin.EARS: (0.4, 0.65),
    Skin.CLENCHED: (0.35, 0.65),
    Skin.MASK: (0.35, 0.65),
    Skin.BRUISE: (0.4, 0.65),
    Skin.MATTED: (0.4, 0.65),
    Skin.STAIRS: (0.4, 0.65),
    Skin.ROUNDED: (0.4, 0.65),
}
# Hair, streaks a few degrees wide, steps of a few millimetres, and the edges of lids and ears
UNEVEN = (Skin.BEARD, Skin.STREAKS, Skin.STAIRS, Skin.ROUNDED)


@functools.cache
def displaced(skin: Skin) -> np.ndarray:
    """Return displacements (draw, point) of a skin at points of the front, and 0.5 mm beside."""
    head = draw_head(SEED, 0)
    front = head.skin_mm[(head.normals[:, 1] < 0.3) & (head.skin_mm[:, 2] > -100.0)][::40]
    beside = front + 0.5 * np.eye(3)[np.arange(len(front)) % 3]
    points = np.concatenate([front, beside])
    return np.array([displace(skin, head.head, points, DRAW, np.random.default_rng(k)) for k in range(60)])


@pytest.mark.parametrize("skin", SHIFTED_BY)
def test_a_skin_that_judges_or_judged_has_its_stated_size_over_the_front_of_the_head(skin: Skin) -> None:
    low, high = SHIFTED_BY[skin]
    front, _ = np.split(displaced(skin), 2, axis=1)
    assert low * DRAW.size_mm < np.sqrt(np.mean(front**2)) < high * DRAW.size_mm


@pytest.mark.parametrize("skin", SHIFTED_BY)
def test_a_skin_is_smooth_but_for_hair_and_edges_of_the_ct_and_all_differ_by_the_seed(skin: Skin) -> None:
    front, beside = np.split(displaced(skin), 2, axis=1)
    is_smooth = np.sqrt(np.mean((front - beside) ** 2)) < 0.15 * np.sqrt(np.mean(front**2))
    assert is_smooth == (skin not in UNEVEN)
    assert np.abs(np.diff(front, axis=0)).max(axis=1).min() > 1e-3


def move(skin: Skin, points: np.ndarray) -> np.ndarray:
    """Return displacements (draw, point), so large that the weak field beside them is nothing."""
    head, big = draw_head(SEED, 0).head, replace(DRAW, size_mm=10.0)
    return np.array([displace(skin, head, points, big, np.random.default_rng(k)) for k in range(30)])


def skin_of(region: Region) -> np.ndarray:
    head = draw_head(SEED, 0)
    return np.asarray(head.skin_mm[regions(head.head, head.skin_mm) == region][::10])


def crests_and_hollows() -> tuple[np.ndarray, np.ndarray]:
    """Return which samples lie on the tip of the nose, and in the corners between eyes and nose."""
    head = draw_head(SEED, 0)
    marks, skin_mm = head.head.landmarks, head.skin_mm
    tip = np.linalg.norm(skin_mm - marks.nose_tip, axis=1) < 12.0
    beside = np.abs(np.abs(skin_mm[:, 0]) - 14.0) < 4.0
    corner = beside & (skin_mm[:, 1] < 0.0) & (np.abs(skin_mm[:, 2] - marks.sellion_mm + 4.0) < 5.0)
    return tip, corner


def test_gravity_moves_the_cheeks_more_than_the_forehead_and_fluid_moves_the_skin_outwards_only() -> None:
    cheeks, foreheads = skin_of(Region.CHEEK), skin_of(Region.FOREHEAD)
    assert np.std(move(Skin.SAG, cheeks)) > 4.0 * np.std(move(Skin.SAG, foreheads))
    swollen = move(Skin.OEDEMA, cheeks)
    assert swollen.min() > -0.3  # of the weak field
    assert swollen.max() > 3.0


def test_pads_a_tube_and_a_beard_leave_the_vault_alone_and_pads_and_a_beard_move_outwards_only() -> None:
    for skin in (Skin.PADS, Skin.TUBE, Skin.BEARD):
        assert np.std(move(skin, skin_of(Region.CHEEK))) > 5.0 * np.std(move(skin, skin_of(Region.VAULT)))
    for skin in (Skin.PADS, Skin.BEARD):
        assert move(skin, skin_of(Region.CHEEK)).min() > -0.3  # of the weak field


def test_thick_slices_shift_the_vertex_and_hydration_the_cheeks_most() -> None:
    vault, cheeks, ears = (skin_of(region) for region in (Region.VAULT, Region.CHEEK, Region.EAR))
    assert np.std(move(Skin.BLUR, vault)) > 2.0 * np.std(move(Skin.BLUR, ears))
    assert np.std(move(Skin.HYDRATION, cheeks)) > 2.0 * np.std(move(Skin.HYDRATION, vault))


def test_thick_slices_shift_the_skin_by_its_slope_against_the_drawn_slices() -> None:
    points, size_mm = skin_of(Region.VAULT), 10.0
    random = np.random.default_rng(0)
    random.integers(2**31)  # seed of the weak field
    blur = draw_blur(random)
    assert BLUR_RATIOS[0] < blur.ratio < BLUR_RATIOS[1]
    slope = (draw_head(SEED, 0).head.normals(points) @ blur.across) ** 2
    width = np.sqrt(1.0 + (blur.ratio**2 - 1.0) * slope) - 1.0
    moved = displace(
        Skin.BLUR, draw_head(SEED, 0).head, points, replace(DRAW, size_mm=size_mm), np.random.default_rng(0)
    )
    assert np.corrcoef(width, moved)[0, 1] ** 2 > 0.99


def test_wheals_and_film_lift_the_skin_only_and_reach_the_vault() -> None:
    for skin in (Skin.WHEALS, Skin.FILM):
        vault = move(skin, skin_of(Region.VAULT))
        assert vault.min() > -0.3  # of the weak field
        assert np.std(vault) > 2.0 * np.std(move(skin, skin_of(Region.JAW)))


def test_steroids_round_or_thin_the_cheeks_and_thin_the_temples_and_hardly_touch_the_vault() -> None:
    head = draw_head(SEED, 0)
    marks = head.head.landmarks
    beside = np.linalg.norm(head.skin_mm[:, 1:] - [marks.ear[1] - 45.0, marks.sellion_mm + 15.0], axis=1)
    temples, cheeks = move(Skin.STEROIDS, head.skin_mm[beside < 10.0]), skin_of(Region.CHEEK)
    assert temples.mean(axis=1).max() < 1.0 < -temples.min()
    assert move(Skin.STEROIDS, cheeks).mean() > 0.5
    assert np.std(move(Skin.STEROIDS, cheeks)) > 3.0 * np.std(move(Skin.STEROIDS, skin_of(Region.VAULT)))


def test_fluid_under_the_scalp_leaves_the_face_alone_and_bent_ears_all_else() -> None:
    vault, cheeks, ears = (skin_of(region) for region in (Region.VAULT, Region.CHEEK, Region.EAR))
    assert np.std(move(Skin.FLUID, vault)) > 10.0 * np.std(move(Skin.FLUID, cheeks))
    for still in (vault, cheeks):
        assert np.std(move(Skin.EARS, ears)) > 10.0 * np.std(move(Skin.EARS, still))


def test_streaks_cross_the_jaw_most_and_in_some_heads_the_vault() -> None:
    jaw, vault = (move(Skin.STREAKS, skin_of(region)) for region in (Region.JAW, Region.VAULT))
    assert np.std(jaw) > 2.0 * np.std(vault)
    is_crossed = np.abs(vault).max(axis=1) > 2.0
    assert 0.1 < is_crossed.mean() < 0.9


def test_clenched_teeth_move_cheeks_and_temples_and_a_mask_the_face_and_neither_the_vertex() -> None:
    head = draw_head(SEED, 0)
    vertex = head.skin_mm[head.skin_mm[:, 2] > 0.8 * head.head.semi_axes_mm[2]][::10]
    for skin in (Skin.CLENCHED, Skin.MASK):
        assert np.std(move(skin, skin_of(Region.CHEEK))) > 8.0 * np.std(move(skin, vertex))
    clenched, masked = (move(skin, skin_of(Region.NOSE)) for skin in (Skin.CLENCHED, Skin.MASK))
    assert np.std(clenched) < 0.1 * np.std(masked)


def test_a_bruise_has_a_rim_that_stands_up_whatever_its_middle_does() -> None:
    moved = move(Skin.BRUISE, skin_of(Region.FOREHEAD))
    assert moved.mean() > 0.5
    assert moved.min() < -5.0


def test_hair_in_the_ct_lies_outside_the_skin_and_ends_at_the_hair_line() -> None:
    vault, cheeks = (move(Skin.MATTED, skin_of(region)) for region in (Region.VAULT, Region.CHEEK))
    assert vault.max() < 0.5  # of the weak field
    assert vault.mean() < -3.0
    assert np.std(cheeks) < 0.1


def test_stairs_of_the_slices_cross_inclined_skin_and_are_nothing_in_the_mean() -> None:
    head = draw_head(SEED, 0)
    slope = np.abs(head.normals[:, 2])
    flat, steep = (move(Skin.STAIRS, head.skin_mm[chosen][::20]) for chosen in (slope > 0.7, slope < 0.1))
    assert np.std(flat) > 2.0 * np.std(steep)
    assert abs(flat.mean()) < 0.1 * np.std(flat)


def test_a_rounded_surface_loses_crests_and_fills_hollows_or_the_reverse() -> None:
    crests, hollows = (
        move(Skin.ROUNDED, draw_head(SEED, 0).skin_mm[chosen]) for chosen in crests_and_hollows()
    )
    assert (crests.mean(axis=1) * hollows.mean(axis=1)).max() < 0.0
    assert crests.mean() > 0.0


def test_a_ct_of_wrong_scale_moves_the_skin_by_less_than_half_a_percent_of_its_distance() -> None:
    head = draw_head(SEED, 0)
    points = head.skin_mm[::40]
    largest = replace(DRAW, size_mm=SIZE_MM[1])
    moved = [displace(Skin.SCALE, head.head, points, largest, np.random.default_rng(k)) for k in range(60)]
    assert np.sqrt(np.mean(np.square(moved) / np.square(points).sum(axis=1))) < 0.005


def test_a_developer_runs_the_study_without_the_judged_skins_and_the_default_has_both() -> None:
    def skins(kinds: Kinds) -> list[str]:
        return [one.condition.partition("|")[2] for one in SurfaceStudy(1, shifts=0, kinds=kinds).units()]

    assert (
        set(skins(Kinds.DEVELOPMENT))
        == set(DEVELOPMENT)
        > {
            *FIRST_JUDGED,
            *SECOND_JUDGED,
            *THIRD_JUDGED,
        }
    )
    assert set(skins(Kinds.JUDGED)) == set(JUDGED)
    assert len(skins(Kinds.JUDGED)) == 30  # six kinds, five coverages: 10,020 judged with 334 heads
    assert sorted(skins(Kinds.ALL)) == sorted([*skins(Kinds.JUDGED), *2 * (Skin.RIGID, Skin.ROUGH)])


def test_tables_of_a_study_with_judged_skins_are_of_these_alone() -> None:
    def goals(*skins: Skin) -> str:
        one = {f"0|{name}": value for name, value in asdict(DRAW).items()} | {"0|refused|SRF-003": 1.0}
        sums = {f"{Coverage.ALL}|{skin}": one for skin in skins}
        return tables.tables(sums)[0].note

    assert goals(Skin.MASK, Skin.WHEALS, Skin.PADS).startswith("1 judged registrations")
    assert goals(Skin.WHEALS, Skin.PADS, Skin.BAND).startswith("3 development registrations")


def test_a_third_of_the_skin_is_shifted_by_one_millimetre() -> None:
    moved = np.abs(shift_third(draw_head(SEED, 0).skin_mm, np.random.default_rng(0)))
    assert moved.max() == pytest.approx(1.0, abs=1e-3)
    assert np.mean(moved > 0.5) == pytest.approx(1.0 / 3.0, abs=0.01)


def test_more_heads_continue_a_study() -> None:
    few, more = SurfaceStudy(heads=1, shifts=1), SurfaceStudy(heads=2, shifts=3)
    assert few.settings() == more.settings()
    assert {unit.key for unit in few.units()} < {unit.key for unit in more.units()}
    assert replace(few, seed=1).settings() != few.settings()


def test_a_registration_is_judged_at_its_targets_and_the_same_unit_gives_the_same() -> None:
    study, unit = SurfaceStudy(seed=SEED), Unit(f"{Coverage.ALL}|{Skin.RIGID}", 0, 1)
    sums = study.run(unit)
    assert sums == study.run(unit)
    (outcome,) = read_outcomes(add_up([(unit, sums)]))
    assert outcome.refusal is None
    assert sorted(set(outcome.depths)) == ["deep", "middle", "superficial"]
    assert outcome.targets[:, 0].max() < 0.5  # a rigid phantom, scanned all around
    assert {table.title for table in tables.tables({unit.condition: sums})} > {"Goals", "By coverage"}


def test_targets_within_their_limits_are_counted_head_by_head() -> None:
    within, beyond = [0.1, 0.1, 0.2], [0.3, 0.1, 0.2]
    outcomes = [
        Outcome("all", "patches", head, {}, None, np.array(rows), ("deep",) * len(rows))
        for head, rows in enumerate([[within, within], [within, beyond]])
    ]
    found = share_within([*outcomes, replace(outcomes[0], refusal="SRF-003")])
    assert found is not None
    assert found.value == 75.0


def test_an_exported_scan_lies_on_its_head_by_the_exported_truth(tmp_path: Path) -> None:
    class OneScan(SurfaceStudy):
        def units(self) -> list[Unit]:
            return [Unit(f"{Coverage.FACE}|{Skin.RIGID}", 0, 1), Unit(SHIFTED, 0, 1)]

    assert export_study(OneScan(seed=SEED), tmp_path, lambda share: None) == 2
    cases, truths = (json.loads((tmp_path / f"{name}.json").read_text()) for name in ("cases", "truth"))
    name = "head-0000-face-only-rigid-phantom"
    header, _, body = (tmp_path / "scans" / f"{name}.ply").read_bytes().partition(b"end_header\n")
    properties = [line.split()[1:] for line in header.decode().splitlines() if line.startswith("property")]
    kinds = {"double": "<f8", "int": "<i4"}
    rows = np.frombuffer(body, dtype=[(field, kinds[kind]) for kind, field in properties])
    truth = Transform.from_matrix(Frame.ROBOT, Frame.CT, truths[name]["robot_from_ct"])
    points = truth.inverse().apply(np.column_stack([rows[axis] for axis in "xyz"]))
    assert np.median(np.abs(draw_head(SEED, 0).head.distance_mm(points))) < truths[name]["noise_mm"]
    assert cases[name]["head"] == "head-0000"
    assert "robot_from_ct" not in cases[name]
    read_me = (tmp_path / "README.md").read_text()
    assert read_me.startswith("# Scans of heads")
    assert {"view_x", "view_y", "view_z"} <= rows.dtype.fields.keys()
    assert "400 mm from the place (0, 0, -30) of the CT" in " ".join(read_me.split())
    assert "1% are displaced along the ray" in read_me


def test_a_start_errs_as_a_whole_by_what_it_states_for_itself() -> None:
    truth = Transform(Frame.ROBOT, Frame.CT, RigidTransform.identity())
    random = np.random.default_rng(SEED)
    starts = [_draw_start(truth, random) for _ in range(2000)]
    away_mm = [np.linalg.norm(one.robot_from_ct.translation_mm) for one in starts]
    turns_rad = [one.robot_from_ct.rigid.rotation.magnitude() for one in starts]
    assert np.sqrt(np.mean(np.square(away_mm))) == pytest.approx(starts[0].place_mm, rel=0.05)
    assert np.sqrt(np.mean(np.square(turns_rad))) == pytest.approx(starts[0].turn_rad, rel=0.05)


def test_shifted_skin_is_a_condition_of_its_own() -> None:
    _, trial, draw = draw_unit(SEED, Unit(SHIFTED, 0, 1))
    assert draw.offset_mm == 0.0
    assert len(trial.scan) > 300
