"""Patient ID of a simulated patient: scene and seed, such as `mini-7`, as its CT series states them."""

from __future__ import annotations

LARGEST_ID = 64  # characters: DICOM value representation LO


def format_patient_id(scene: str, seed: int) -> str:
    """Format the patient ID; the end of a scene name too long for it is lost."""
    tail = f"-{seed}"
    return scene[: LARGEST_ID - len(tail)] + tail


def parse_patient_id(patient_id: str) -> tuple[str, int] | None:
    """Return scene and seed, or None for the ID of another patient."""
    scene, _, seed = patient_id.rpartition("-")
    return (scene, int(seed)) if scene and seed.isdecimal() else None
