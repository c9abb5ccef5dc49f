"""Arguments that name a run and an output of it."""

from __future__ import annotations

import contextlib
from collections.abc import Iterator
from pathlib import Path
from typing import Annotated

from typer import Argument, CallbackParam, Option

from procedures.reporting.page_file import PAGE_SUFFIX
from ronna_hw.command_line.errors import UsageMistake
from ronna_hw.command_line.messages import tell
from ronna_hw.command_line.options import require_folder_of


def require_run_folder(folder: Path) -> Path:
    """Return the folder. Raises CLI-005 unless it is a run folder."""
    from procedures.runs.folders import require_run

    require_run(folder)
    return folder


RunArgument = Annotated[
    Path, Argument(metavar="RUN", help="Folder of a run, however it ended.", callback=require_run_folder)
]
FolderOption = Annotated[
    Path | None, Option("--out", metavar="DIR", help="Output folder; by default inside the run's.")
]


def require_page(parameter: CallbackParam, out: Path) -> Path:
    """Return the file for a page; a folder gets it by its usual name, and is created if need be.

    Raises CLI-001 for another type, CLI-005 in a run or without a folder around it.
    """
    if out.is_dir() or not out.suffix:
        folder, out = out, out / Path(str(parameter.default)).name
        require_folder_of(folder)
        folder.mkdir(exist_ok=True)
    if out.suffix.lower() != PAGE_SUFFIX:
        raise UsageMistake(
            f"--out: {out.name} is no page",
            expected=f"a name that ends in {PAGE_SUFFIX}",
            action=f"Write {out.with_suffix(PAGE_SUFFIX).name}, open it in a browser and print it on A4, or "
            "to a PDF.",
        )
    require_folder_of(out)
    return out


@contextlib.contextmanager
def telling_replacement(page: Path) -> Iterator[None]:
    """Say after the block that a page took the place of another."""
    existed = page.exists()
    yield
    if existed:
        tell(f"{page} was there before and has been replaced; --out FILE writes elsewhere")


PageOption = Annotated[
    Path,
    Option(
        "--out",
        metavar="FILE",
        help="The page to write, or its folder: HTML, to be printed on A4.",
        callback=require_page,
    ),
]
