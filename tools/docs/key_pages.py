"""The pages of the files that users write: every table of a theatre file and of a scene, key by key."""

from __future__ import annotations

from model_tables import model_tables

from ronna_hw.config import TheatreFile
from sim.theatre.scene.model import Scene

THEATRE_HEAD = """# Keys of the theatre file

TOML. All tables are strict: unknown keys are errors, and all errors are reported at once. Lengths are in
millimetres, poses are target <- source. `ronna-sim theatre` writes such a file to start from.
"""
SCENE_HEAD = """# Keys of a scene

The ground truth of a simulated theatre, as TOML or JSON for `--scene FILE`. All tables are strict. Lengths
are in millimetres, angles in radians where the name says `rad`, CT coordinates in DICOM's LPS, and poses are
target <- source.
`ronna-sim scene --scene mini --seed 4 > scene.toml` writes a built-in one to start from.
"""


def key_pages() -> dict[str, str]:
    """File name -> content of the page of each file."""
    return {
        "scene-file.md": f"{SCENE_HEAD}\n{model_tables({'scene': Scene})}",
        "theatre-file.md": f"{THEATRE_HEAD}\n{model_tables({'theatre file': TheatreFile})}",
    }
