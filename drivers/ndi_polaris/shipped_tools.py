"""Tool definitions shipped with the driver: robot reference frame M, the x-shaped and the patient's frame.

`python -P -m drivers.ndi_polaris.shipped_tools` regenerates them; a test compares the committed files.
"""

from __future__ import annotations

from datetime import date
from functools import partial
from pathlib import Path

from drivers.ndi_polaris.tool_definition import ToolDefinition, encode_definition, make_planar_tool
from ronna_hw import patient_frame, x_frame

FOLDER = Path(__file__).parent / "definitions"
MANUFACTURER = "RONNA"
# Frame M, four spheres on the tool mount. Six distances at least 4 mm apart, so that the pose is unique.
ROBOT_FRAME_MARKERS_MM = ((0.0, 0.0, 0.0), (45.0, 60.0, 0.0), (-30.0, 85.0, 0.0), (-62.0, 30.0, 12.0))


def build_shipped_definitions() -> dict[str, ToolDefinition]:
    """Build the shipped definitions, keyed by file name; markers in mm, in the tool frame."""
    make = partial(make_planar_tool, manufacturer=MANUFACTURER)
    on_skull = (x_frame.PART_NUMBER, x_frame.SPHERE_CENTRES_MM, x_frame.OUTWARD)
    on_clamp = (patient_frame.PART_NUMBER, patient_frame.MARKERS_MM)
    return {
        "robot_frame.rom": make("RONNA-M", ROBOT_FRAME_MARKERS_MM, made_on=date(2025, 1, 6)),
        f"{x_frame.NAME}.rom": make(*on_skull, made_on=date(2025, 1, 7)),
        f"{patient_frame.NAME}.rom": make(*on_clamp, made_on=date(2025, 1, 8)),
    }


def find_definition(path: Path, folder: Path | None = None) -> Path:
    """Resolve the path of a tool definition relative to `folder`, by default the working directory.

    A bare name without an existing file, with or without `.rom`, selects the shipped definition of that name.
    """
    found = path if folder is None else folder / path
    shipped = FOLDER / f"{path.stem}.rom"
    is_bare = path.name == str(path) and path.suffix in ("", ".rom")
    return shipped if is_bare and not found.exists() and shipped.exists() else found


def main() -> None:
    """Write all shipped definitions as .rom files."""
    FOLDER.mkdir(exist_ok=True)
    for name, tool in build_shipped_definitions().items():
        (FOLDER / name).write_bytes(encode_definition(tool))


if __name__ == "__main__":
    main()
