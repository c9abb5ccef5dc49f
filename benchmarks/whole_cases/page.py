"""The table of whole cases on the page of the strategies, with an entry for each row in its figures file.

`docs/reference/figures/README.md` says what such an entry is.
"""

from __future__ import annotations

import re
from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import Any

from benchmarks.whole_cases.block import ROOT
from benchmarks.whole_cases.table import Figures

PAGE = Path("docs/explanation/strategies.md")
FIGURES_FILE = Path("docs/reference/figures/whole-cases.toml")
BEGIN, END = "<!-- written by python -m benchmarks.whole_cases: do not edit -->", "<!-- written so far -->"
COLUMNS = (
    "| {} | cases | refused | targets | mean, largest mm | within the limit "
    "| minus `ocs`, mm | better at | image pairs | theatre s |"
)
CAPTIONS = {
    "uncalibrated": "uncalibrated arm",
    "calibrated": "calibrated arm",
    "x_frame_uncalibrated": "x-shaped frame, uncalibrated",
    "x_frame_calibrated": "x-shaped frame, calibrated",
    "thesis_sphere_uncalibrated": "`thesis-sphere` and the thesis' matcher, uncalibrated",
    "thesis_sphere_calibrated": "`thesis-sphere` and the thesis' matcher, calibrated",
    "thesis_line_uncalibrated": "`thesis-line` and the thesis' matcher, uncalibrated",
    "thesis_line_calibrated": "`thesis-line` and the thesis' matcher, calibrated",
    "ur5e_uncalibrated": "UR5e, uncalibrated",
    "ur5e_calibrated": "UR5e, calibrated",
    "two_arms": "two arms",
    "skin_phantom": "rigid phantom without markers",
    "bone_phantom": "rigid phantom without markers, bone bare at the forehead",
    "skin": "head without markers, whose skin has moved",
    "mixed": "the same with a few screws",
    "seating_uncalibrated": "spheres refitted to 0.22 mm per axis, uncalibrated arm",
    "seating_calibrated": "spheres refitted to 0.22 mm per axis, calibrated arm",
}
# Cells of a row: what they show, and the figures in it.
CELLS = (
    ("{}", ("cases",)),
    ("{}", ("refused",)),
    ("{} of {}", ("reached", "planned")),
    ("{:.3f}, {:.3f}", ("mean_mm", "largest_mm")),
    ("{} of {}", ("within", "reached")),
)
PAIRED = (("{:+.3f}", ("paired.mean_mm",)), ("{} of {}", ("paired.better", "paired.targets")))
COSTS = (("{:.0f}", ("looks_mean",)), ("{:.0f}", ("theatre_mean_s",)))

Summary = Mapping[str, Mapping[str, Figures]]


def write_page(summary: Summary, kept: str, command: str, root: Path = ROOT) -> None:
    """Write table and figures file. `kept` is the summary's file from the root, `command` what made it."""
    page = root / PAGE
    text = page.read_text(encoding="utf-8")
    table = "\n".join([BEGIN, "", *_table(summary), END])
    written = re.sub(f"{re.escape(BEGIN)}.*?{re.escape(END)}", lambda _: table, text, flags=re.DOTALL)
    page.write_text(written, encoding="utf-8")
    entries = [
        _entry(group, strategy, figures, kept, command)
        for group, rows in summary.items()
        for strategy, figures in rows.items()
    ]
    heading = "# Whole cases on the block of decision 31, written by python -m benchmarks.whole_cases."
    (root / FIGURES_FILE).parent.mkdir(parents=True, exist_ok=True)
    (root / FIGURES_FILE).write_text("\n".join([heading, *entries]), encoding="utf-8")


def _table(summary: Summary) -> Iterator[str]:
    for group, rows in summary.items():
        yield COLUMNS.format(CAPTIONS[group])
        yield "|" + "---|" * (COLUMNS.count("|") - 1)
        for strategy, figures in rows.items():
            form, paths = _form(strategy, figures)
            yield form.format(*(_find(figures, path) for path in paths))
        yield ""


def _form(strategy: str, figures: Figures) -> tuple[str, list[str]]:
    """Return the form of a row, and the figures in it."""
    paired = figures.get("paired", {}).get("targets")
    cells = (*CELLS, *(PAIRED if paired else (("", ()), ("", ()))), *COSTS)
    if not figures["reached"]:
        cells = (*CELLS[:3], *[("", ())] * (len(CELLS) - 3 + len(PAIRED) + len(COSTS)))
    row = " | ".join([f"| `{strategy}`", *(form for form, _ in cells)]) + " |"
    return row, [path for _, paths in cells for path in paths]


def _find(figures: Figures, path: str) -> Any:
    found: Any = figures
    for name in path.split("."):
        found = found[name]
    return found


def _entry(group: str, strategy: str, figures: Figures, kept: str, command: str) -> str:
    form, paths = _form(strategy, figures)
    row = form.format(*(_find(figures, path) for path in paths))
    values = ", ".join(f'"{group}.{strategy}.{path}"' for path in paths)
    return (
        f'\n[[figure]]\npage = "{PAGE}"\nstates = "{row}"\nkept = "{kept}"\nvalues = [{values}]\n'
        f'format = "{form}"\ncommand = "{command}"\n'
    )
