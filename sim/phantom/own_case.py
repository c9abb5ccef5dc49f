"""Case of a scene whose head is a user's CT: the series itself, a plan for it and its truth."""

from __future__ import annotations

import json
import shutil
from pathlib import Path

import numpy as np

from ronna_hw.records import write_atomically
from sim.errors import BAD_SCENE
from sim.phantom.case import PLAN_FILE, SERIES_FOLDER, TRUTH_FILE, PhantomCase, plan_toml
from sim.phantom.head.anatomy import Anatomy
from sim.phantom.head.obstacles import SKIN_ONLY
from sim.phantom.scan import Scan
from sim.phantom.scanner.grid import centre_grid
from sim.world.head_surface.volume_head import list_slices
from sim.world.scene.model import Scene


def write_own_case(scene: Scene, folder: Path) -> PhantomCase:
    """Copy the series of the scene's own CT and plan trajectories on it; raises SIM-001 if it is gone."""
    if scene.head.own_ct is None:
        raise BAD_SCENE(f"the head of {scene.name} is no CT of your own")
    slices = list_slices(Path(scene.head.own_ct))
    series = folder / SERIES_FOLDER
    series.mkdir(parents=True)
    for path, _ in slices:
        shutil.copyfile(path, series / path.name)
    first = slices[0][1]
    uid, position = str(first.SeriesInstanceUID), str(first.PatientPosition)
    scan = Scan(
        scene, centre_grid(np.array(scene.head.centre_ct_mm), scene.ct), Anatomy((), (), (), ()), SKIN_ONLY
    )
    truth, plan = folder / TRUTH_FILE, folder / PLAN_FILE
    targets = [
        {"id": one.identifier, "entry_mm": list(one.entry_ct_mm), "target_mm": list(one.target_ct_mm)}
        for one in scene.head.targets
    ]
    content = {"scene": scene.name, "seed": scene.seed, "series_instance_uid": uid, "fiducials": []}
    write_atomically(truth, json.dumps(content | {"targets": targets}, indent=1).encode())
    write_atomically(plan, plan_toml(scan, uid, position).encode())
    return PhantomCase(series, truth, uid, len(slices), plan)
