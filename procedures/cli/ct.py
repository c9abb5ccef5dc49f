"""`ronna-ct`: marker sphere localization in a CT series (postoperative CT: see `postoperative.py`)."""

from __future__ import annotations

import time
from collections.abc import Sequence
from dataclasses import replace
from enum import StrEnum
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

from typer import Argument, Option

from procedures.cli.fuse import fuse
from procedures.cli.postoperative import postoperative
from procedures.imaging.localizers import LOCALIZERS, Localizer
from ronna_hw.command_line import terminal
from ronna_hw.command_line.errors import PATH_PROBLEM, UsageMistake
from ronna_hw.command_line.options import require_folder_of, require_output_folder
from ronna_hw.text import format_count

if TYPE_CHECKING:
    from procedures.imaging import Candidate, Localization, Marker

X_FRAME = "xframe"  # a layout that needs no file
READING_SHARE = 0.4  # of the progress bar
PAGE_ENDING = ".html"
PICTURED_CANDIDATES = 12  # when the count is wrong: as many as a person will look at
SeriesArgument = Annotated[
    Path, Argument(metavar="SERIES_DIR", help="Folder with the DICOM files of one CT series.")
]
DiameterOption = Annotated[
    float, Option("--diameter-mm", min=2.0, max=50.0, help="Diameter of the marker spheres in mm.")
]
app = terminal.command_group(
    "ronna-ct", "Localize marker spheres in a CT series, and check the postoperative CT."
)

# mypy wants its members in the code, but they are those of the table.
LocalizationMethod = StrEnum("LocalizationMethod", {one.name: row.method for one, row in LOCALIZERS.items()})  # type: ignore[misc]
COMBINED = LocalizationMethod(LOCALIZERS[Localizer.OURS].method)

app.command()(postoperative)
app.command()(fuse)


@app.command()
def localize(
    series_dir: SeriesArgument,
    diameter_mm: DiameterOption = 11.5,
    expected: Annotated[
        int | None,
        Option("--expected", metavar="N", min=1, help="Fail unless exactly this many markers are found."),
    ] = None,
    method: Annotated[
        LocalizationMethod,
        Option("--method", help="combined is ours; the other two are the thesis methods, for comparison."),
    ] = COMBINED,
    layout: Annotated[
        str | None,
        Option(
            "--layout",
            metavar="xframe|FILE",
            help="Keep only this layout, in its order, or fail: the x-shaped frame, or points as for --pick.",
        ),
    ] = None,
    pick: Annotated[
        Path | None,
        Option(
            "--pick",
            metavar="FILE",
            help="Search only near these rough points (LPS, mm): CSV, JSON list or Slicer .mrk.json.",
        ),
    ] = None,
    show_candidates: Annotated[
        bool, Option("--candidates", help="Also list every candidate and why it was accepted or rejected.")
    ] = False,
    pictures: Annotated[
        Path | None,
        Option(
            "--pictures",
            metavar="DIR",
            help="Write a picture of each marker to this folder; of the candidates when the count is wrong.",
        ),
    ] = None,
    write: Annotated[
        list[Path] | None,
        Option(
            "--write",
            metavar="FILE",
            help="Write the spheres: .dcm (Spatial Fiducials), .json, .mrk.json, .csv.",
        ),
    ] = None,
    identity: Annotated[
        bool,
        Option(
            "--identity",
            help="Include the patient's identity in the output, and in .dcm files for an archive.",
        ),
    ] = False,
    as_json: terminal.JsonOption = False,
) -> None:
    """Find the centres of all marker spheres, in patient coordinates (LPS, mm).

    sigma is the predicted 3-D error of a centre (rms), agree the distance between its two estimates, both in
    mm. elapsed_s is the localization time without reading the files. Exit codes: 0 markers found, 1 the
    series is unusable or a file cannot be written, 2 usage, 3 no markers, not the expected number (the
    candidates are listed) or not the layout, 130 interrupted.
    """
    import procedures.imaging as imaging
    from procedures.exchange.sphere_files import check_names, is_dicom, write_spheres
    from procedures.imaging.errors import MarkerCountWrong
    from procedures.imaging.scan_deformation import require_undeformed

    check_names(write or ())
    require_folder_of(*(write or ()))
    if pictures is not None:
        require_output_folder(pictures)
    if pick is not None and method is not COMBINED:
        raise UsageMistake(
            "--pick works with the combined method only",
            expected=f"--method {COMBINED}",
            got=f"--method {method}",
            action="Omit --method, or omit --pick.",
        )
    picks_mm = None if pick is None else imaging.read_picks(pick)
    layout_mm = None if layout is None else _read_layout_mm(layout)
    refused: MarkerCountWrong | None = None
    with terminal.progress_bar("reading and localizing") as advance:
        volume = imaging.read_series(series_dir, progress=lambda share: advance(READING_SHARE * share))
        log = terminal.command_logger()
        log.info("series read", shape=volume.geometry.shape, spacing_mm=volume.geometry.spacing_mm.tolist())
        patient = imaging.read_identity(series_dir) if identity else None
        study = None
        if identity and any(is_dicom(path) for path in write or ()):
            from procedures.exchange.ct_study import read_ct_study

            study = read_ct_study(series_dir, volume.series_instance_uid)
        began_s = time.perf_counter()
        localize_in = partial(LOCALIZERS[Localizer[method.name]].load(), volume)
        if picks_mm is not None:
            localize_in = partial(imaging.localize_picks, volume, picks_mm)
        try:
            result = localize_in(
                diameter_mm=diameter_mm,
                expected=expected,
                progress=lambda share: advance(READING_SHARE + (1.0 - READING_SHARE) * share),
            )
        except MarkerCountWrong as error:
            refused = error
        elapsed_s = time.perf_counter() - began_s
        log.info("localized", method=method, refused=refused, elapsed_s=round(elapsed_s, 3))
    if patient is not None and not as_json:
        terminal.tell(f"patient: {patient.describe()}")
    for sentence in volume.warnings:
        terminal.tell(f"warning: {sentence}")
    if refused is not None:
        ranked = imaging.likeliest_first(refused.candidates)
        if show_candidates and as_json:
            terminal.print_json({"candidates": _list_candidates(ranked)})
        elif show_candidates:
            _print_candidates(ranked)
        if pictures is not None:
            from procedures.imaging.pictures import draw_candidates

            _write_pictures(pictures, "candidate", draw_candidates(volume, ranked[:PICTURED_CANDIDATES]))
        raise refused
    require_undeformed(result.deformation)
    for one in result.doubtful:
        if not as_json:
            terminal.tell(f"doubtful, {'picked' if one.accepted else 'not taken'}: {one.describe()}")
    found = None
    if layout_mm is not None:
        from procedures.registration import find_layout

        found = find_layout(layout_mm, result.centres_mm)
        result = replace(result, markers=tuple(result.markers[place] for place in found.order))
    if pictures is not None:
        from procedures.imaging.pictures import draw_candidates, draw_markers

        _write_pictures(pictures, "marker", draw_markers(volume, result))
        doubtful = result.doubtful[:PICTURED_CANDIDATES]
        if doubtful:
            _write_pictures(pictures, "doubtful", draw_candidates(volume, doubtful))
    write_spheres(result, write or (), volume.study_instance_uid, study)
    candidates = imaging.likeliest_first(result.candidates) if show_candidates else None
    if as_json:
        document: dict[str, Any] = {
            "markers": [marker.document() for marker in result.markers],
            "series_instance_uid": result.series_instance_uid,
            "elapsed_s": elapsed_s,
        }
        if result.deformation is not None:
            document["deformation"] = result.deformation.model_dump(mode="json")
        if patient is not None:
            document["patient"] = patient.as_dict()
        if candidates is not None:
            document["candidates"] = _list_candidates(candidates)
        if found is not None:
            document["layout"] = {"residual_rms_mm": found.residual_rms_mm, "others": len(found.others)}
        terminal.print_json(document)
        return
    if found is not None:
        terminal.tell(
            f"the layout was found to {found.residual_rms_mm:.3f} mm rms; other spheres: {len(found.others)}"
        )
    _print_markers(result)
    if candidates is not None:
        _print_candidates(candidates)


@app.command()
def adhesive(
    series_dir: SeriesArgument,
    expected: Annotated[
        int | None,
        Option("--expected", metavar="N", min=1, help="Fail unless exactly this many rings are found."),
    ] = None,
    as_json: terminal.JsonOption = False,
) -> None:
    """Find adhesive rings on the skin, in patient coordinates (LPS, mm): for comparison, not for a case.

    sigma is the predicted 3-D error of a centre (rms) in this CT; the skin, which carries the ring, is not in
    it. Exit codes: 0 rings found, 1 the series is unusable, 2 usage, 3 none or not the expected number, 130
    interrupted.
    """
    from procedures.imaging import read_series
    from procedures.imaging.adhesive import localize_adhesives

    with terminal.progress_bar("reading") as advance:
        volume = read_series(series_dir, progress=advance)
    rings = localize_adhesives(volume, expected)
    if as_json:
        documents = []
        for one in rings:
            place = {"centre_mm": list(one.centre_mm), "normal": list(one.normal), "sigma_mm": one.sigma_mm}
            radii = {"outer_radius_mm": one.outer_radius_mm, "inner_radius_mm": one.inner_radius_mm}
            documents.append({**place, "covariance_mm2": one.covariance_mm2.tolist(), **radii})
        terminal.print_json({"rings": documents, "series_instance_uid": volume.series_instance_uid})
        return
    rows = []
    for number, one in enumerate(rings, start=1):
        lengths = (f"{value:.3f}" for value in (*one.centre_mm, one.sigma_mm))
        rows.append([number, *lengths, f"{one.outer_radius_mm:.2f}", f"{one.inner_radius_mm:.2f}"])
    headings = ["#", "L mm", "P mm", "S mm", "sigma mm", "outer mm", "inner mm"]
    terminal.print_table(f"{format_count(len(rings), 'adhesive ring')}, LPS in mm", headings, rows)


@app.command()
def view(
    series_dir: SeriesArgument,
    out: Annotated[
        Path, Option("--out", metavar="FILE", help="The page to write; open it in a browser.")
    ] = Path("ct.html"),
    diameter_mm: DiameterOption = 11.5,
) -> None:
    """Write one HTML page of a CT: three planes to scroll, markers and candidates with reasons and odds.

    A click shows a position in LPS mm; picked positions can be given to localize --pick. The page is
    self-contained, needs no network and does not name the patient. A series without markers gets a page, too,
    and one with deformed markers (CT-024) before it is refused.
    """
    import procedures.imaging as imaging
    from procedures.imaging.ct_page import ct_page
    from procedures.imaging.errors import MarkerCountWrong
    from procedures.imaging.scan_deformation import require_undeformed
    from ronna_hw.records import write_atomically

    if out.suffix.lower() != PAGE_ENDING:
        raise PATH_PROBLEM(
            f"--out: {out} is no page", expected=f"a file that ends in {PAGE_ENDING}", action="Name another."
        )
    require_folder_of(out)
    with terminal.progress_bar("reading and localizing") as advance:
        volume = imaging.read_series(series_dir, progress=lambda share: advance(READING_SHARE * share))
        markers: Sequence[Marker] = ()
        deformation = None
        try:
            result = imaging.localize(volume, diameter_mm=diameter_mm)
            markers, candidates, deformation = result.markers, result.candidates, result.deformation
        except MarkerCountWrong as error:
            candidates = error.candidates
        ranked = imaging.likeliest_first(candidates)
        doubtful = sum(one.doubtful for one in ranked)
        rejected = len(ranked) - len(markers) - doubtful
        outcome = f"{format_count(len(markers), 'marker')} found, {doubtful} doubtful, {rejected} rejected."
        page = ct_page(volume, f"CT series {series_dir.resolve().name}", markers, ranked, outcome)
    write_atomically(out, page.encode())
    terminal.tell(f"{outcome} Page {out}")
    require_undeformed(deformation)


def _read_layout_mm(layout: str) -> Any:
    """Read the sphere positions (k, 3) mm of a layout, in its own frame. Raises CT-018, also for k < 3."""
    from procedures.imaging import read_picks
    from procedures.imaging.errors import PicksUnreadable
    from procedures.registration.points import FEWEST_PAIRS
    from ronna_hw.x_frame import SPHERE_CENTRES_MM

    if layout == X_FRAME:
        return SPHERE_CENTRES_MM
    if not Path(layout).exists():
        raise PicksUnreadable(
            f"--layout: there is no file {layout}", expected=f"{X_FRAME} or a file of points"
        )
    spheres_mm = read_picks(Path(layout))
    if len(spheres_mm) < FEWEST_PAIRS:
        raise PicksUnreadable(
            f"{Path(layout).name} is not a layout",
            expected=f"at least {FEWEST_PAIRS} points",
            got=str(len(spheres_mm)),
        )
    return spheres_mm


def _list_candidates(candidates: Sequence[Candidate]) -> list[dict[str, Any]]:
    return [
        {"centre_mm": list(one.centre_mm), "accepted": one.accepted, "odds": one.odds, "reason": one.reason}
        for one in candidates
    ]


def _print_markers(result: Localization) -> None:
    rows = []
    for number, marker in enumerate(result.markers, start=1):
        lengths_mm = (*marker.centre_mm, marker.sigma_mm, marker.agreement_mm)
        sizes = (f"{marker.radius_mm:.2f}", f"{marker.quality:.2f}")
        rows.append([number, *(f"{value:.3f}" for value in lengths_mm), *sizes, " ".join(marker.flags)])
    headings = ["#", "L mm", "P mm", "S mm", "sigma mm", "agree mm", "radius mm", "quality", "flags"]
    terminal.print_table(f"{format_count(len(rows), 'marker')}, LPS in mm", headings, rows)


def _print_candidates(candidates: Sequence[Candidate]) -> None:
    rows = []
    for one in candidates:
        share = "" if one.surface_share is None else f"{one.surface_share:.0%}"
        radius = "" if one.radius_mm is None else f"{one.radius_mm:.2f}"
        odds = f"{one.odds:.2f}"
        rows.append([*(f"{value:z.1f}" for value in one.centre_mm), share, radius, odds, one.reason])
    headings = ["L mm", "P mm", "S mm", "surface", "radius mm", "odds", "outcome"]
    terminal.print_table(f"{format_count(len(rows), 'candidate')}, LPS in mm", headings, rows)


def _write_pictures(folder: Path, name: str, pictures: Sequence[bytes]) -> None:
    folder.mkdir(parents=True, exist_ok=True)
    for number, picture in enumerate(pictures, start=1):
        (folder / f"{name}-{number}.png").write_bytes(picture)


def main() -> None:
    terminal.run(app)


if __name__ == "__main__":
    main()
