"""`ronna-ct fuse`: registration of another series, such as an MR, to the CT."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Annotated

from typer import Argument, Option

from ronna_hw.command_line import terminal
from ronna_hw.command_line.errors import PATH_PROBLEM
from ronna_hw.command_line.options import require_new

if TYPE_CHECKING:
    from ronna_hw.arrays import Array

READING_SHARE = 0.1  # of the progress bar, for each series
RECORD_ENDING, PICTURE_ENDING, TRANSFORM_ENDING = ".json", ".png", ".tfm"


def fuse(
    ct_dir: Annotated[Path, Argument(metavar="CT_DIR", help="Folder of the planning CT.")],
    other_dir: Annotated[Path, Argument(metavar="OTHER_DIR", help="Folder of the MR, PET or second CT.")],
    out: Annotated[
        Path,
        Option(
            "--out",
            metavar="FILE",
            help="The fusion to write, .json; beside it a chequerboard, .png, and a transform for 3D Slicer, "
            ".tfm.",
        ),
    ],
    landmarks: Annotated[
        tuple[Path, Path] | None,
        Option(
            "--landmarks",
            metavar="CT_POINTS OTHER_POINTS",
            help="Check by the same points in both series, in one order: CSV, JSON list or Slicer .mrk.json.",
        ),
    ] = None,
    as_json: terminal.JsonOption = False,
) -> None:
    """Register another series to the CT, rigidly, by mutual information; refused unless it can be trusted.

    Registrations from seven starts and of six halves of the head must agree: that shows a wrong result, a
    distorted series or another head. A person should look at the chequerboard all the same. Takes a minute.
    Exit codes: 0 fused, 1 a series is unusable, 2 usage or SimpleITK is missing, 3 refused, 130 interrupted.
    """
    from procedures.fusion.chequerboard import draw_chequerboard
    from procedures.fusion.mutual_information import require_simple_itk
    from procedures.fusion.record import format_fusion, format_itk_transform
    from procedures.fusion.registration import fuse_series
    from procedures.imaging import read_other_series, read_series
    from procedures.planning.head_in_ct import fit_head
    from ronna_hw.records import write_atomically

    if out.suffix != RECORD_ENDING:
        raise PATH_PROBLEM(
            f"--out: {out} is no fusion",
            expected=f"a file that ends in {RECORD_ENDING}",
            action="Name another.",
        )
    picture, transform = out.with_suffix(PICTURE_ENDING), out.with_suffix(TRANSFORM_ENDING)
    require_new(out, picture, transform)
    require_simple_itk()
    points_mm = None if landmarks is None else _read_landmarks(*landmarks)
    warnings = check_same_patient(ct_dir, other_dir)
    with terminal.progress_bar("reading and registering") as advance:
        ct = read_series(ct_dir, progress=lambda share: advance(READING_SHARE * share))
        other, modality = read_other_series(
            other_dir, progress=lambda share: advance(READING_SHARE * (1.0 + share))
        )
        fusion = fuse_series(
            ct,
            other,
            modality,
            landmarks_mm=points_mm,
            progress=lambda share: advance(2.0 * READING_SHARE + (1.0 - 2.0 * READING_SHARE) * share),
        )
        sheet = draw_chequerboard(ct, other, fusion, fit_head(ct).centre_mm)
    write_atomically(picture, sheet)
    write_atomically(transform, format_itk_transform(fusion).encode())
    write_atomically(out, format_fusion(fusion))
    for sentence in (*warnings, *ct.warnings, *other.warnings):
        terminal.tell(f"warning: {sentence}")
    if as_json:
        terminal.print_json(fusion.model_dump(mode="json", by_alias=True))
        return
    terminal.say(
        f"{out}: {modality} registered; expected error {fusion.expected_mm:.2f} mm rms in the head, "
        f"{fusion.agreeing_starts} of {fusion.starts} starts agree, {fusion.overlap:.0%} of the head is shown"
    )
    if fusion.landmarks is not None:
        terminal.say(
            f"{fusion.landmarks.count} landmarks meet to {fusion.landmarks.rms_mm:.2f} mm rms, "
            f"{fusion.landmarks.largest_mm:.2f} mm at most"
        )
    terminal.say(f"now look at {picture}: edges must run on from square to square")
    terminal.say(f"then: ronna-plan open {ct_dir} --fusion {out} --other {other_dir}")


def _read_landmarks(ct_points: Path, other_points: Path) -> tuple[Array, Array]:
    from procedures.imaging import read_picks

    return read_picks(ct_points), read_picks(other_points)


def check_same_patient(ct_dir: Path, other_dir: Path) -> tuple[str, ...]:
    """Raise FUS-003 if the patient identifiers differ; return a warning if one is missing."""
    from procedures.fusion.errors import OTHER_PATIENT
    from procedures.imaging import read_identity

    one, other = (read_identity(folder).identifier for folder in (ct_dir, other_dir))
    if one and other and one != other:  # messages never name patients
        raise OTHER_PATIENT("the two series have different patient identifiers")
    if one and other:
        return ()
    return ("not both series have a patient identifier: check by eye that they are of the same patient",)
