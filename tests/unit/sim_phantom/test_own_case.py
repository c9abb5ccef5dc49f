import json
import tomllib
from pathlib import Path

import numpy as np
import pytest
from coded_errors import raises
from shared_by_workers import made_once

from sim.errors import BAD_SCENE
from sim.phantom.case import write_case
from sim.phantom.own_case import write_own_case
from sim.phantom.scan import plain_scan
from sim.world.options import Carrier
from sim.world.rigid import apply, matrix_of
from sim.world.scene.model import CtProtocol, Scene, parse_scene
from sim.world.scene.named_scenes import draw_scene
from sim.world.scene.own_head import with_own_head
from sim.world.scene.skin import skin_in_ct, skin_in_theatre

COARSE = CtProtocol(pixel_mm=2.0, slice_mm=3.0, columns=128, rows=128, slices=88, noise_HU=10.0)
SEED = 3


def scanned() -> Scene:
    scene = draw_scene("mini", seed=SEED, fiducials=Carrier.SURFACE)
    assert scene.head.face is not None
    face = scene.head.face.model_copy(update={"hair_mm": 0.0})
    return scene.model_copy(update={"ct": COARSE, "head": scene.head.model_copy(update={"face": face})})


@pytest.fixture(scope="module")
def series(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A CT of somebody's head."""
    return Path(
        made_once(tmp_path_factory, "own ct", lambda root: str(write_case(scanned(), root / "ct").series))[1]
    )


@pytest.fixture(scope="module")
def own(series: Path) -> Scene:
    return with_own_head(draw_scene("mini", seed=8, targets=3, fiducials=Carrier.SURFACE), series)


def test_a_ct_becomes_the_head_where_the_drawn_head_was(own: Scene) -> None:
    truth, drawn = scanned().head, draw_scene("mini", seed=8, fiducials=Carrier.SURFACE).head
    assert own.head.centre_ct_mm == pytest.approx(truth.centre_ct_mm, abs=5.0)
    assert own.head.semi_axes_mm[:2] == pytest.approx(truth.semi_axes_mm[:2], abs=1.5)
    middles = [apply(matrix_of(one.robot_from_ct), one.centre_ct_mm) for one in (own.head, drawn)]
    assert middles[0] == pytest.approx(middles[1], abs=1e-3)


def test_its_trajectories_begin_on_the_skin_and_keep_their_depths(own: Scene) -> None:
    entries = np.array([one.entry_ct_mm for one in own.head.targets])
    assert len(entries) == 3
    assert skin_in_theatre(own.head).distance_mm(entries) == pytest.approx(0.0, abs=0.01)
    assert skin_in_ct(scanned().head).distance_mm(entries) == pytest.approx(0.0, abs=0.5)
    drawn = draw_scene("mini", seed=8, targets=3, fiducials=Carrier.SURFACE).head
    assert [one.depth_mm for one in own.head.targets] == pytest.approx(
        [one.depth_mm for one in drawn.targets], abs=1e-3
    )


def test_its_case_is_the_series_itself_with_a_plan(own: Scene, series: Path, tmp_path: Path) -> None:
    case = write_own_case(own, tmp_path / "case")
    copied = sorted(case.series.iterdir())
    assert [one.name for one in copied] == sorted(one.name for one in series.iterdir())
    assert copied[7].read_bytes() == (series / copied[7].name).read_bytes()
    plan = tomllib.loads(case.plan.read_text())
    assert (plan["series_instance_uid"], plan["fiducials"]) == (case.series_instance_uid, "surface")
    assert len(plan["trajectories"]) == len(json.loads(case.truth.read_text())["targets"]) == 3


def test_a_head_as_scanned_has_neither_spheres_nor_another_scan(own: Scene) -> None:
    with raises(BAD_SCENE, match="cannot be scanned again"):
        write_case(own, Path("unused"), scan=plain_scan(own.model_copy(update={"ct": CtProtocol()})))
    content = own.model_dump(by_alias=True, mode="json")
    content["head"]["fiducials"] = draw_scene("mini").model_dump(by_alias=True, mode="json")["head"][
        "fiducials"
    ]
    with raises(BAD_SCENE, match="own_ct is a head as scanned"):
        parse_scene(content, "scene.toml")


def test_a_ct_without_a_head_is_refused(tmp_path: Path) -> None:
    with raises(BAD_SCENE, match="no CT series"):
        with_own_head(draw_scene("mini", fiducials=Carrier.SURFACE), tmp_path)
