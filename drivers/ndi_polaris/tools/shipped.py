"""The tool definitions shipped with the driver.

`python -P -m drivers.ndi_polaris.tools.shipped` regenerates them; a test compares the committed files.
"""

from __future__ import annotations

from pathlib import Path

from drivers.ndi_polaris.rom.definition import ToolDefinition, encode_definition
from drivers.ndi_polaris.tools import robot_frame, x_frame

FOLDER = Path(__file__).parent / "definitions"


def shipped_definitions() -> dict[str, ToolDefinition]:
    """File name -> definition."""
    return {
        f"{robot_frame.NAME}.rom": robot_frame.robot_frame(),
        f"{x_frame.NAME}.rom": x_frame.x_frame(),
    }


def find_definition(path: Path, folder: Path | None = None) -> Path:
    """Resolve the path of a definition; relative paths start at `folder`, or the working directory.

    A bare name of no existing file, with or without `.rom`, is the shipped definition of that name.
    """
    found = path if folder is None else folder / path
    shipped = FOLDER / f"{path.stem}.rom"
    bare = path.name == str(path) and path.suffix in ("", ".rom")
    return shipped if bare and not found.exists() and shipped.exists() else found


def main() -> None:
    """Write all shipped definitions."""
    FOLDER.mkdir(exist_ok=True)
    for name, tool in shipped_definitions().items():
        (FOLDER / name).write_bytes(encode_definition(tool))


if __name__ == "__main__":
    main()
