"""Spoils the orientation of a phantom, CT and plan alike; as a program, runs a whole case on such a phantom.

    python mirrored_case.py columns run --sim --scene mini --seed 2

The plan is made on the spoilt CT, as a surgeon would, and fits it.
"""

from __future__ import annotations

import sys
import tomllib
from pathlib import Path

import numpy as np
import pydicom
import tomli_w

SWAPPED = np.array([[0.0, 1.0, 0.0], [1.0, 0.0, 0.0], [0.0, 0.0, 1.0]])
MIRRORS = {  # of the voxels, under unchanged headers
    "columns": np.diag([-1.0, 1.0, 1.0]),
    "rows": np.diag([1.0, -1.0, 1.0]),
    "slices": np.diag([1.0, 1.0, -1.0]),
    "swapped axes": SWAPPED,
}
QUARTER = np.array([[0.0, -1.0, 0.0], [1.0, 0.0, 0.0], [0.0, 0.0, 1.0]])
TURNS = {  # of the headers' directions and positions: as if the head had lain so in the scanner
    "turned to HFP": np.diag([-1.0, -1.0, 1.0]),
    "turned to FFS": np.diag([-1.0, 1.0, -1.0]),
    "turned to FFP": np.diag([1.0, -1.0, -1.0]),
    "turned to HFDR": QUARTER,
    "turned to HFDL": QUARTER.T,
}
LABELS = ("HFP", "FFP", "HFDR", "HFDL")  # patient positions of CT and plan, for a head that lies HFS
KINDS = (*MIRRORS, "header", *TURNS, *LABELS)


def spoil(folder: Path, kind: str) -> None:
    """Spoil `ct/` and `plan.toml` of a phantom."""
    paths = sorted((folder / "ct").glob("*.dcm"))
    slices = [pydicom.dcmread(path) for path in paths]
    origin = np.array(slices[0].ImagePositionPatient, dtype=float)
    last = slices[-1]
    across = float(last.PixelSpacing[0]) * np.array([last.Columns - 1, last.Rows - 1, 0.0])
    middle = (origin + np.array(last.ImagePositionPatient, dtype=float) + across) / 2.0
    voxels = np.stack([one.pixel_array for one in slices])
    turn = {**MIRRORS, **TURNS, "header": MIRRORS["columns"]}.get(kind, np.eye(3))
    if kind in MIRRORS:
        moved = {
            "columns": voxels[:, :, ::-1],
            "rows": voxels[:, ::-1],
            "slices": voxels[::-1],
            "swapped axes": voxels.swapaxes(1, 2),
        }[kind]
    else:
        moved, middle = voxels, np.zeros(3)
    for one, path, plane in zip(slices, paths, moved, strict=True):
        one.PixelData = np.ascontiguousarray(plane).tobytes()
        if kind not in MIRRORS:
            directions = np.array(one.ImageOrientationPatient, dtype=float).reshape(2, 3) @ turn.T
            one.ImageOrientationPatient = [f"{value:g}" for value in directions.ravel()]
            place = turn @ np.array(one.ImagePositionPatient, dtype=float)
            one.ImagePositionPatient = [f"{value:.6f}" for value in place]
        if kind in LABELS:
            one.PatientPosition = kind
        one.save_as(path)
    plan_file = folder / "plan.toml"
    plan = tomllib.loads(plan_file.read_text())
    if kind in LABELS:
        plan["patient_orientation"] = kind
    for one in plan["trajectories"]:
        for end in ("entry_mm", "target_mm"):
            one[end] = (turn @ (np.array(one[end]) - middle) + middle).tolist()
    plan_file.write_text(tomli_w.dumps(plan))


def main() -> None:
    """Run `ronna-procedure` with these arguments on a patient whose CT is spoilt."""
    from procedures.cli.procedure import main as procedure
    from procedures.runs.simulated_theatre import SimulatedTheatre

    kind, *sys.argv[1:] = sys.argv[1:]
    await_patient = SimulatedTheatre.await_patient

    # The simulator's own command has no such fault: the type checker is told that both lines reach into it.
    def await_spoilt(case: SimulatedTheatre) -> None:
        await_patient(case)
        assert case._phantom is not None
        arguments = list(map(str, case._phantom.args))  # type: ignore[arg-type]
        spoil(Path(arguments[arguments.index("--out") + 1]), kind)

    SimulatedTheatre.await_patient = await_spoilt  # type: ignore[assignment,method-assign]
    procedure()


if __name__ == "__main__":
    main()
