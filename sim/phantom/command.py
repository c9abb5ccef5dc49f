"""`ronna-sim phantom`: a head CT with its plan and truth."""

from __future__ import annotations

from collections.abc import Callable, Collection, Iterator
from dataclasses import replace
from enum import StrEnum
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from ronna_hw.arm.catalogue import ArmChoice
from ronna_hw.command_line.errors import UsageMistake
from ronna_hw.command_line.options import require_folder
from ronna_hw.command_line.terminal import JsonOption, print_json, progress_bar
from ronna_hw.errors import EXIT_INTERRUPTED
from ronna_hw.host.process import Parent
from ronna_hw.text import escape_controls, format_count
from sim.world.options import Carrier, InstrumentKind, MarkersOption, SceneOption, TargetsOption

if TYPE_CHECKING:
    from sim.phantom.case import PhantomCase
    from sim.phantom.scan import Scan
    from sim.world.scene.model import Scene

SCANNER = "What the scanner does"
DURING, AFTERWARDS = "During the operation", "After the operation"
ADHESIVES = 8  # on each patient of the thesis
# Parameters that a scan during the operation follows; the second, unless it is of a theatre.
OF_CONE_BEAM = frozenset(("out", "seed", "cone_beam", "theatre", "aim_mm", "with_parent", "as_json"))
OF_ITS_SCENE = frozenset(("scene", "markers", "targets"))
DEFAULT_SCENE, DEFAULT_FAMILY, DEFAULT_PROTOCOL = "default", "plain", "good"


class Fiducials(StrEnum):
    """Markers: spheres on screws or on a frame, adhesive rings, or the skin of a face with few spheres."""

    FREE = "free"
    XFRAME = "xframe"
    XFRAME_CLOSE = "xframe-close"
    ADHESIVE = "adhesive"
    SURFACE = "surface"
    MIXED = "mixed"


def _scanner_option(about: str, *names: str, **limits: Any) -> Any:
    return typer.Option(*names, help=about, rich_help_panel=SCANNER, **limits)


def phantom(
    context: typer.Context,
    out: Annotated[Path, typer.Option(help="New or empty folder for ct/, plan.toml and truth.json.")],
    scene: SceneOption = DEFAULT_SCENE,
    seed: Annotated[int, typer.Option(min=0, help="Seed of a built-in scene.")] = 0,
    markers: MarkersOption = None,
    targets: TargetsOption = None,
    family: Annotated[
        str | None, typer.Option(help="Generate head and surroundings of this family instead of a scene.")
    ] = None,
    protocol: Annotated[
        str | None, typer.Option(help="good, usual or poor; default for a family: good.")
    ] = None,
    fiducials: Annotated[
        Fiducials,
        typer.Option(
            help="Spheres on individual screws, on the x-shaped frame, or on the close-set frame of the "
            "studies; with a family, --markers beyond four are on screws. Or adhesive rings on the skin, "
            "which only the CT shows, and no spheres. `surface` and `mixed`: a head with a face, without "
            "spheres or with 1 to 3; --family then names what is around it: free, resting, folded, "
            "intubated, clamped."
        ),
    ] = Fiducials.FREE,
    arm: Annotated[
        ArmChoice, typer.Option(case_sensitive=False, help="Arm of a named scene, which reaches the plan.")
    ] = ArmChoice.KR6,
    tilt_deg: Annotated[float, _scanner_option("Gantry tilt.")] = 0.0,
    tilt_hidden: Annotated[bool, _scanner_option("Headers of upright slices.", "--tilt-hidden")] = False,
    table_scale: Annotated[
        float, _scanner_option("Relative error of the table feed.", min=-0.1, max=0.1)
    ] = 0.0,
    thickness_mm: Annotated[
        float | None,
        _scanner_option(
            "Slice thickness; above the slice spacing, slices overlap. [default: the spacing]",
            min=0.1,
            max=20.0,
        ),
    ] = None,
    beam_hardening: Annotated[float, _scanner_option("Strength; 1 is typical.", min=0.0, max=10.0)] = 0.0,
    motion_mm: Annotated[
        float, _scanner_option("Distance of a single patient movement.", min=0.0, max=20.0)
    ] = 0.0,
    slide_mm: Annotated[
        float, _scanner_option("Distance along the table of a single patient movement.", min=-20.0, max=20.0)
    ] = 0.0,
    kernel: Annotated[str, _scanner_option("standard, smooth or sharp.")] = "standard",
    extended_range: Annotated[bool, _scanner_option("Store metal above 3071 HU.")] = False,
    metal_artefacts: Annotated[
        bool,
        _scanner_option("Streaks and shadows of metal, from the physics of the scan.", "--metal-artefacts"),
    ] = False,
    stretch: Annotated[
        float,
        _scanner_option("Stretch of the whole image, relative to its size.", min=-0.1, max=0.1),
    ] = 0.0,
    stretch_along: Annotated[
        tuple[float, float, float],
        _scanner_option("Direction of that stretch, L P S."),
    ] = (0.0, 0.0, 1.0),
    with_mr: Annotated[
        bool,
        typer.Option(
            "--mr",
            help="Also write an MR of the head, mr/ and mr-truth.json: another contrast and pose, without "
            "markers.",
        ),
    ] = False,
    mr_distortion_mm: Annotated[
        float,
        typer.Option(min=0.0, max=5.0, help="Largest displacement in that MR, at the skin; with --mr."),
    ] = 0.3,
    cone_beam: Annotated[
        bool,
        typer.Option(
            "--cone-beam",
            help="Scan the clamped head with its refitted spheres instead, by cone beam: a small field, "
            "more noise, cupping, streaks of screws and clamp, another pose.",
            rich_help_panel=DURING,
        ),
    ] = False,
    theatre: Annotated[
        Path | None,
        typer.Option(
            metavar="FOLDER",
            help="With --cone-beam: the head in this simulated theatre as it is now, instead of the scene's.",
            rich_help_panel=DURING,
        ),
    ] = None,
    aim_mm: Annotated[
        float,
        typer.Option(
            min=0.0,
            max=100.0,
            help="With --cone-beam: largest error of the field's aim at the spheres, per axis.",
            rich_help_panel=DURING,
        ),
    ] = 8.0,
    postoperative: Annotated[
        Path | None,
        typer.Option(
            metavar="RUN",
            help="Scan the head of this run after the operation instead: another pose, spheres removed, "
            "with the instruments that the run left.",
            rich_help_panel=AFTERWARDS,
        ),
    ] = None,
    instrument: Annotated[
        InstrumentKind,
        typer.Option(help="Instrument in the head, with --postoperative.", rich_help_panel=AFTERWARDS),
    ] = InstrumentKind.ELECTRODE,
    with_parent: Annotated[bool, typer.Option(hidden=True, help="End when the parent ends.")] = False,
    as_json: JsonOption = False,
) -> None:
    """Write the CT series of a head phantom, a plan for it, and its ground truth.

    Families for tuning a localizer: plain, posts, bands, dressing, rounded, joined, caps,
    sizes, screws. For testing it: narrow, broad, clamp, electrodes, bandage, soaked, crowded, edge, streaks,
    rays, metal, bare and, with objects
    that are not spheres, ends, plates, hollow, fittings.
    """
    from sim.errors import BAD_SCENE, FOLDER_NOT_EMPTY
    from sim.phantom.case import SERIES_FOLDER, TRUTH_FILE, write_case, write_mr
    from sim.phantom.families.face_scan import SURFACE_FAMILY, face_scan
    from sim.phantom.families.family_scan import family_scan, protocol_named
    from sim.phantom.mr_scan import draw_mr
    from sim.phantom.own_case import write_own_case
    from sim.phantom.scan import plain_scan
    from sim.phantom.scanner.faults import NO_FAULTS, ScannerFaults
    from sim.world.process import load_scene
    from sim.world.scene.named_scenes import MARKERS_ON_SKIN, whole_head

    if cone_beam:
        _require_cone_beam_options(context)
    elif only := next(_list_typed(context, ("theatre", "aim_mm")), None):
        raise UsageMistake(f"{only} is for a scan during the operation", action="Add --cone-beam.")
    require_folder(out)
    if out.is_dir() and any(out.iterdir()):
        unfinished = (out / SERIES_FOLDER).is_dir() and not (out / TRUTH_FILE).exists()
        kept = "holds slices of a scan that was not finished" if unfinished else "is not empty"
        raise FOLDER_NOT_EMPTY(f"{out} {kept}; nothing in it was changed")
    if postoperative is not None:
        if (
            scene != DEFAULT_SCENE
            or family is not None
            or markers is not None
            or targets is not None
            or arm is not ArmChoice.KR6
        ):
            raise BAD_SCENE(
                "the run defines head and trajectories; omit --scene, --family and similar options"
            )
        _write_postoperative(postoperative, instrument, out, seed, protocol, as_json)
        return
    if cone_beam:
        _write_cone_beam(
            theatre,
            lambda: load_scene(scene, seed=seed, markers=markers, targets=targets),
            out,
            seed,
            aim_mm,
            as_json,
        )
        return
    shifts_mm = (motion_mm, slide_mm)
    faults = ScannerFaults(
        tilt_deg,
        table_scale,
        thickness_mm,
        beam_hardening,
        *shifts_mm,
        kernel,
        extended_range,
        tilt_hidden,
        metal_artefacts,
        stretch,
        stretch_along,
    )
    carrier = {one.value: one for one in Carrier}.get(fiducials.value)
    if fiducials is Fiducials.ADHESIVE:
        if family is not None:
            raise BAD_SCENE("a family has no adhesive markers", action="Omit --family or --fiducials.")
        truth, scan = _scan_adhesives(scene, seed, markers, targets, arm, protocol)
    elif carrier in MARKERS_ON_SKIN:
        truth = load_scene(scene, seed=seed, markers=markers, targets=targets, fiducials=carrier, arm=arm)
        if protocol is not None:
            truth = truth.model_copy(update={"ct": whole_head(protocol_named(protocol))})
        scan = face_scan(truth, family or SURFACE_FAMILY, fiducials.value)
        truth = scan.scene
    elif family is not None or carrier is None:
        if scene != DEFAULT_SCENE or targets is not None or arm is not ArmChoice.KR6:
            raise BAD_SCENE(
                "a family generates its own head and trajectory", action="Omit --scene, --targets and --arm."
            )
        scan = family_scan(
            family or DEFAULT_FAMILY,
            protocol or DEFAULT_PROTOCOL,
            seed=seed,
            markers=markers,
            fiducials=fiducials.value,
        )
        truth = scan.scene
        if faults == NO_FAULTS:
            faults = scan.faults
    else:
        truth = load_scene(scene, seed=seed, markers=markers, targets=targets, fiducials=carrier, arm=arm)
        if truth.head.own_ct is not None:
            _show(write_own_case(truth, out), truth, "spheres", as_json)
            return
        if protocol is not None:
            truth = truth.model_copy(update={"ct": protocol_named(protocol)})
        scan = plain_scan(truth)
    with progress_bar("scanning the phantom") as progress:

        def report(share: float) -> None:
            if with_parent and Parent.noted.is_gone:  # a thread that watches it would stand in the fork's way
                raise typer.Exit(EXIT_INTERRUPTED)
            progress(share)

        case = write_case(truth, out, report, scan=replace(scan, faults=faults))
        if with_mr:
            write_mr(draw_mr(truth, seed, distortion_mm=mr_distortion_mm), out)
    _show(case, truth, "adhesive rings" if fiducials is Fiducials.ADHESIVE else "spheres", as_json)


def _show(case: PhantomCase, truth: Scene, kind: str, as_json: bool) -> None:
    """Print what was written."""
    shown = len(truth.head.adhesives if kind == "adhesive rings" else truth.head.fiducials)
    targets = len(truth.head.targets)
    if as_json:
        print_json(
            {
                "series": str(case.series),
                "plan": str(case.plan),
                "truth": str(case.truth),
                "series_instance_uid": case.series_instance_uid,
                "slices": case.slices,
                "markers": shown,
                "targets": targets,
            }
        )
        return
    typer.echo(
        escape_controls(
            f"{case.series}: {case.slices} slices, {shown} {kind}, "
            f"{format_count(targets, 'trajectory', 'trajectories')} in {case.plan}"
        )
    )


def _scan_adhesives(
    scene: str,
    seed: int,
    markers: int | None,
    targets: int | None,
    arm: ArmChoice,
    protocol: str | None,
) -> tuple[Scene, Scan]:
    """Return a scene with adhesive markers, those of its file or drawn ones, and their scan."""
    from sim.phantom.families.family_scan import protocol_named
    from sim.phantom.scan import adhesive_scan
    from sim.world.noise import noise
    from sim.world.process import load_scene
    from sim.world.scene.head import stick_adhesives

    truth = load_scene(scene, seed=seed, targets=targets, fiducials=Carrier.FREE, arm=arm)
    if markers is not None or not truth.head.adhesives:
        generator = noise(truth.seed, "adhesive sites", 0)
        truth = truth.model_copy(
            update={"head": stick_adhesives(truth.head, markers or ADHESIVES, generator)}
        )
    if protocol is not None:
        truth = truth.model_copy(update={"ct": protocol_named(protocol)})
    return truth, adhesive_scan(truth)


def _list_typed(context: typer.Context, names: Collection[str]) -> Iterator[str]:
    """Yield the options that were typed, as typed, of the parameters with these names."""
    for parameter in context.command.params:
        source = context.get_parameter_source(str(parameter.name))
        if parameter.name in names and source is not None and source.name == "COMMANDLINE":
            yield parameter.opts[0]


def _require_cone_beam_options(context: typer.Context) -> None:
    """Raise CLI-001 for options that a scan during the operation would not follow."""
    from sim.world.scene.named_scenes import BENCH_DISTANCES_MM

    followed = OF_CONE_BEAM if context.params["theatre"] is not None else OF_CONE_BEAM | OF_ITS_SCENE
    others = {str(one.name) for one in context.command.params} - followed
    if ignored := list(_list_typed(context, others)):
        with_theatre = " --theatre" if followed == OF_CONE_BEAM else ""
        raise UsageMistake(
            f"--cone-beam{with_theatre} does not follow {', '.join(ignored)}",
            action=f"Omit {', '.join(ignored)}, or --cone-beam for a CT.",
        )
    if context.params["scene"] in BENCH_DISTANCES_MM:
        raise UsageMistake(
            f"--cone-beam scans a clamped head, and on --scene {context.params['scene']} none is clamped",
            action="Name another scene, such as default.",
        )


def _write_cone_beam(
    theatre: Path | None, load: Callable[[], Scene], out: Path, seed: int, aim_mm: float, as_json: bool
) -> None:
    from sim.phantom.cone_beam_case import head_in_theatre, write_cone_beam
    from sim.phantom.cone_beam_scan import draw_cone_beam
    from sim.world.displacements import spheres_in_theatre

    if theatre is None:
        scene = load()
        spheres = spheres_in_theatre(scene)
    else:
        scene, spheres = head_in_theatre(theatre)
    scan = draw_cone_beam(scene, spheres, seed, aim_mm=aim_mm)
    with progress_bar("scanning the phantom") as progress:
        case = write_cone_beam(scan, out, progress)
    whole = sum(scan.share_shown(marker) >= 1.0 for marker in scan.markers)
    if as_json:
        print_json(
            {
                "series": str(case.series),
                "truth": str(case.truth),
                "series_instance_uid": case.series_instance_uid,
                "slices": case.slices,
                "markers": len(scan.markers),
                "whole": whole,
            }
        )
        return
    typer.echo(
        escape_controls(f"{case.series}: {case.slices} slices, {whole} of {len(scan.markers)} spheres whole")
    )


def _write_postoperative(
    run: Path, instrument: InstrumentKind, out: Path, seed: int, protocol: str | None, as_json: bool
) -> None:
    from sim.phantom.case import write_postoperative
    from sim.phantom.families.family_scan import protocol_named
    from sim.phantom.postoperative_scan import draw_scan, instruments_of

    scene, instruments = instruments_of(run, instrument)
    scan = draw_scan(scene, instruments, seed, None if protocol is None else protocol_named(protocol))
    with progress_bar("scanning the phantom") as progress:
        case = write_postoperative(scan, instruments, out, progress)
    if as_json:
        print_json(
            {
                "series": str(case.series),
                "truth": str(case.truth),
                "series_instance_uid": case.series_instance_uid,
                "slices": case.slices,
                "instruments": len(instruments),
            }
        )
        return
    inside = format_count(len(instruments), instrument.value)
    typer.echo(escape_controls(f"{case.series}: {case.slices} slices, {inside}"))
