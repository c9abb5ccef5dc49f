"""The tool definitions that come with the driver.

`python -P -m drivers.ndi_polaris.tools.shipped` writes them again; a test compares the committed files.
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
    """The file that a path means: relative paths begin in `folder`, or where the program was started.

    A bare name that is not there, with or without `.rom`, means the definition of that name that comes with
    the driver.
    """
    found = path if folder is None else folder / path
    shipped = FOLDER / f"{path.stem}.rom"
    bare = path.name == str(path) and path.suffix in ("", ".rom")
    return shipped if bare and not found.exists() and shipped.exists() else found


def main() -> None:
    """Write every shipped definition."""
    FOLDER.mkdir(exist_ok=True)
    for name, tool in shipped_definitions().items():
        (FOLDER / name).write_bytes(encode_definition(tool))


if __name__ == "__main__":
    main()
