"""Iterative closest points of small-gicp and Open3D on exported scans, for `benchmarks.surface.same_clouds`.

    python cloud_peers.py FOLDER OUT.jsonl

Runs in an environment of its own with `numpy`, `small-gicp` and `open3d-cpu`; it reads what `ronna-campaign
surface --export` wrote, and nothing of this project. One line for each scan, method and setting: the pose
CT <- robot and the processor time. Each method starts where ours does, from the start by the tracker, and has
the samples of the head at 1.5 mm with their exact normals.
"""

from __future__ import annotations

import argparse
import json
import time
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import numpy as np
import open3d as o3d  # type: ignore[import-not-found]  # only in the environment of the peers
import small_gicp  # type: ignore[import-not-found]  # likewise

PLY_TYPES = {"double": "<f8", "float": "<f4", "int": "<i4"}
# The sweep: each method with each of these
DISTANCES_MM = (2.0, 10.0)  # pairs further apart are left out; 5 mm does not differ
KERNEL_WIDTHS_MM = (0.3, 1.0)  # of robust kernels
SCAN_NORMALS = 12  # neighbours for the covariances of a scan's points
ITERATIONS = 60
Pose = np.ndarray
Method = Callable[[], Pose]


def main() -> None:
    parser = argparse.ArgumentParser()
    parser.add_argument("folder", type=Path)
    parser.add_argument("out", type=Path)
    given = parser.parse_args()
    cases = json.loads((given.folder / "cases.json").read_text(encoding="utf-8"))
    o3d.utility.set_verbosity_level(o3d.utility.VerbosityLevel.Error)
    heads: dict[str, dict[str, np.ndarray]] = {}
    with given.out.open("w", encoding="utf-8") as out:
        for name, case in cases.items():
            if case["head"] not in heads:
                heads = {case["head"]: read_ply(given.folder / "heads" / f"{case['head']}.ply")}
            head = heads[case["head"]]
            normals = columns(head, ("nx", "ny", "nz"))
            skin = columns(head, ("x", "y", "z")) + case["level_in_ct_mm"] * normals
            scan = columns(read_ply(given.folder / "scans" / f"{name}.ply"), ("x", "y", "z"))
            start = np.linalg.inv(np.array(case["start_robot_from_ct"]))
            for method, setting, run in methods(scan, skin, normals, start):
                since = time.process_time()
                pose = run()
                spent = time.process_time() - since
                line = {"scan": name, "method": method, "setting": setting, "cpu_s": spent}
                out.write(json.dumps({**line, "ct_from_robot": np.asarray(pose).tolist()}) + "\n")


def methods(
    scan: np.ndarray, skin: np.ndarray, normals: np.ndarray, start: Pose
) -> Iterator[tuple[str, str, Method]]:
    """Yield name, setting and function of each method in each setting."""
    source, target = small_gicp.PointCloud(scan), small_gicp.PointCloud(skin)
    tree = small_gicp.KdTree(target, num_threads=1)
    small_gicp.estimate_normals_covariances(target, tree, num_neighbors=SCAN_NORMALS, num_threads=1)
    small_gicp.estimate_normals_covariances(
        source, small_gicp.KdTree(source, num_threads=1), num_neighbors=SCAN_NORMALS, num_threads=1
    )
    for kind in ("ICP", "PLANE_ICP", "GICP"):
        for reach in DISTANCES_MM:
            yield (
                f"small-gicp {kind}",
                f"pairs up to {reach:g} mm",
                lambda kind=kind, reach=reach: (
                    small_gicp.align(  # type: ignore[misc]
                        target,
                        source,
                        tree,
                        init_T_target_source=start,
                        registration_type=kind,
                        max_correspondence_distance=reach,
                        num_threads=1,
                        max_iterations=ITERATIONS,
                    ).T_target_source
                ),
            )
    cloud, surface = _cloud(scan), _cloud(skin)
    surface.normals = o3d.utility.Vector3dVector(normals)
    neighbours = o3d.geometry.KDTreeSearchParamKNN(SCAN_NORMALS)
    cloud.estimate_normals(neighbours)
    stop = o3d.pipelines.registration.ICPConvergenceCriteria(max_iteration=ITERATIONS)
    for name, estimation in _open3d_estimations():
        align = o3d.pipelines.registration.registration_icp
        if name.startswith("generalized"):
            align = o3d.pipelines.registration.registration_generalized_icp
        for reach in DISTANCES_MM:
            yield (
                f"Open3D {name.partition(';')[0]}",
                f"pairs up to {reach:g} mm{name.partition(';')[2]}",
                lambda align=align, reach=reach, estimation=estimation: (
                    align(  # type: ignore[misc]
                        cloud, surface, reach, start, estimation, stop
                    ).transformation
                ),
            )


def _open3d_estimations() -> Iterator[tuple[str, Any]]:
    """Yield name and setting of each estimation of Open3D."""
    registration = o3d.pipelines.registration
    yield "point to point", registration.TransformationEstimationPointToPoint()
    yield "point to plane", registration.TransformationEstimationPointToPlane()
    yield "generalized", registration.TransformationEstimationForGeneralizedICP()
    kernels = {
        "Tukey": registration.TukeyLoss,
        "Cauchy": registration.CauchyLoss,
        "Huber": registration.HuberLoss,
        "Geman and McClure": registration.GMLoss,
    }
    for name, kernel in kernels.items():
        for width in KERNEL_WIDTHS_MM:
            yield (
                f"point to plane, {name};, kernel {width:g} mm",
                registration.TransformationEstimationPointToPlane(kernel(width)),
            )


def _cloud(points: np.ndarray) -> Any:
    return o3d.geometry.PointCloud(o3d.utility.Vector3dVector(points))


def read_ply(path: Path) -> dict[str, np.ndarray]:
    """Return the properties of the vertices of a binary PLY file."""
    head, _, body = path.read_bytes().partition(b"end_header\n")
    words = [line.split() for line in head.decode().splitlines()]
    fields = [(line[2], PLY_TYPES[line[1]]) for line in words if line[0] == "property"]
    count = next(int(line[2]) for line in words if line[:2] == ["element", "vertex"])
    rows = np.frombuffer(body, dtype=fields, count=count)
    return {name: rows[name] for name, _ in fields}


def columns(of: dict[str, np.ndarray], names: tuple[str, ...]) -> np.ndarray:
    """Return some properties as an array (n, k)."""
    return np.column_stack([of[name] for name in names]).astype(float)


if __name__ == "__main__":
    main()
