"""`ronna-campaign`: Monte-Carlo studies on all cores, or on the workers of a Dask scheduler."""

from __future__ import annotations

import json
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Protocol

import typer

from procedures.registration.thesis_settings import (
    REFUSED_SHARE,
    REFUSED_SHARE_RANGE,
    THESIS_TOLERANCES_MM,
)
from ronna_hw.command_line import terminal
from ronna_hw.command_line.errors import UsageMistake
from ronna_hw.command_line.options import require_output_folder, with_option_records
from ronna_hw.errors import EXIT_FAILED
from ronna_hw.text import format_count
from studies.surface.kinds import Kinds

if TYPE_CHECKING:
    from studies.campaign.study import Study, Sums, Table
    from studies.plugins.method import PluginMethod

app = typer.Typer(
    name="ronna-campaign",
    help="Monte Carlo studies compared with the thesis: seeded, resumable, identical on any workers.",
    no_args_is_help=True,
    add_completion=False,
    rich_markup_mode=None,
)


@dataclass(frozen=True)
class StudyOptions:
    """Common options of a study: seed, workers and output folder."""

    seed: Annotated[int, typer.Option(min=0, help="Seed of all random numbers.")] = 0
    workers: Annotated[int | None, typer.Option(min=1, help="Processes on this computer [one per core].")] = (
        None
    )
    scheduler: Annotated[
        str | None,
        typer.Option(metavar="ADDRESS", help="Dask scheduler to run on, such as tcp://127.0.0.1:8786."),
    ] = None
    out: Annotated[
        Path | None, typer.Option(metavar="DIR", help="Folder of the study [campaigns/<name>].")
    ] = None
    as_json: terminal.JsonOption = False


OwnOption = Annotated[
    list[str] | None,
    typer.Option(
        "--method",
        metavar="NAME|MODULE:FUNCTION",
        help="A method of your own, run alongside ours; repeatable.",
    ),
]

MOST_CASES_AT_ONCE = 2  # each starts five processes in real time
THESIS_RUNS = 10_000  # per patient and cell
Plots = Callable[[Mapping[str, "Sums"]], dict[str, bytes]]


class Results(Protocol):
    """A module or object that tabulates the sums of a study; it may also have `plots`."""

    def tables(self, sums: Mapping[str, Sums], /) -> list[Table]: ...


@app.command()
@with_option_records
def correspondence(
    runs: Annotated[
        int | None,
        typer.Option("--runs", min=1, help="Runs per patient and cell [10000], or readings [1415]."),
    ] = None,
    sweep: Annotated[
        bool,
        typer.Option(
            "--sweep",
            help="Both similarity matrices, or each --method, with 51 values of e from 1 to 6 mm.",
        ),
    ] = False,
    template: Annotated[
        bool,
        typer.Option(
            "--template", help="3 and 4 markers implanted with a template from `ronna-plan template`."
        ),
    ] = False,
    methods: Annotated[
        list[str] | None,
        typer.Option(
            "--method",
            metavar="NAME|MODULE:FUNCTION",
            help="Only this method: clique, orientation, count, thesis, thesis-validated, gradual, "
            "gradual-validated, or a pairing of your own; repeatable [all but the last].",
        ),
    ] = None,
    tolerances_mm: Annotated[
        list[float] | None,
        typer.Option(
            "--e",
            min=0.1,
            max=10.0,
            metavar="MM",
            help="Value of e of the similarity matrices in mm; repeatable [1.5 and 2.5].",
        ),
    ] = None,
    refused_share: Annotated[
        float | None,
        typer.Option(
            "--refuse",
            min=REFUSED_SHARE_RANGE[0],
            max=REFUSED_SHARE_RANGE[1],
            metavar="SHARE",
            help="Share of correct pairings that the validation of a similarity matrix refuses "
            f"[{REFUSED_SHARE:g}].",
        ),
    ] = None,
    xframe: Annotated[
        bool, typer.Option("--xframe", help="An x-shaped frame: 17 scans, readings of the simulated tracker.")
    ] = False,
    wrong: Annotated[
        bool,
        typer.Option(
            "--wrong", help="Only ours, with wrong assumptions: noise, strays, a tracker that distorts."
        ),
    ] = False,
    *,
    study_options: StudyOptions,
) -> None:
    """Correspondence of unordered points with outliers: ours and the thesis method on the same data.

    The thesis' similarity matrix loses all failing rows and columns at once, our gradual one a point at a
    time. Each is run both without and with validation of its pairs against the stated errors.
    """
    from studies.correspondence import pairing_misspecified, tables
    from studies.correspondence import template as template_study
    from studies.correspondence.study import SWEPT, USUAL_TOLERANCES_MM, CorrespondenceStudy
    from studies.plugin_trial import select_methods

    if xframe + sweep + template + wrong > 1:
        selected = {"--sweep": sweep, "--xframe": xframe, "--template": template, "--wrong": wrong}
        raise _several_studies([option for option, is_given in selected.items() if is_given])
    if sweep and tolerances_mm:
        raise UsageMistake(
            "--e cannot be combined with --sweep, which has its own", action="Omit one of the two."
        )
    if (xframe or template or wrong) and (methods or tolerances_mm or refused_share):
        raise UsageMistake(
            "--method, --e and --refuse cannot be combined with --xframe, --template or --wrong, which have "
            "their own",
            action="Omit the options of the method, or those of the study.",
        )
    seed = study_options.seed
    if xframe:
        _run_clinical(runs, study_options)
        return
    runs = runs or THESIS_RUNS
    if template:
        _run(template_study.TemplateStudy(runs, seed), template_study, study_options)
    elif wrong:
        wrongly = pairing_misspecified.MisspecifiedPairingStudy(runs, seed)
        _run(wrongly, pairing_misspecified, study_options)
    else:
        chosen, own = select_methods(methods or (), terminal.tell)
        values_mm = tuple(sorted(set(tolerances_mm))) if tolerances_mm else USUAL_TOLERANCES_MM
        refused = refused_share or REFUSED_SHARE
        study = CorrespondenceStudy(runs, seed, chosen, values_mm, own=own, refused_share=refused)
        if sweep:
            swept = replace(
                study,
                methods=chosen if methods else SWEPT,
                tolerances_mm=THESIS_TOLERANCES_MM,
                name="correspondence-sweep",
            )
            _run(swept, tables, study_options, tables.plot_figure_13)
        else:
            _run(study, tables, study_options)


def _run_clinical(readings: int | None, study_options: StudyOptions) -> None:
    """Run the clinical protocol on readings stored in the study's folder, taking them if missing."""
    from studies.correspondence import clinical
    from studies.correspondence.frame_readings import load_or_take_readings

    folder = study_options.out or Path("campaigns") / clinical.ClinicalStudy.name
    with terminal.progress_bar("readings of the tracker") as progress:
        readings_mm = load_or_take_readings(
            folder, readings or clinical.THESIS_READINGS, study_options.seed, progress
        )
    study = clinical.ClinicalStudy(readings_mm, study_options.seed)
    _run(study, clinical, replace(study_options, out=folder))


@app.command()
@with_option_records
def registration(
    runs: Annotated[int, typer.Option("--runs", min=1, help="Runs per cell.")] = 6_000,
    methods: OwnOption = None,
    *,
    study_options: StudyOptions,
) -> None:
    """Rigid registration: how well its error formulas hold, and what weighting gains."""
    from studies import registration as registrations

    own = _try_plugins("REGISTRATION", methods)
    _run(registrations.RegistrationStudy(runs, study_options.seed, own=own), registrations, study_options)


@app.command()
@with_option_records
def localization(
    volumes: Annotated[
        int, typer.Option("--volumes", min=1, help="Phantom scans per family and protocol.")
    ] = 6,
    sets: Annotated[
        int, typer.Option("--sets", min=1, help="Sets of five scans of the x-shaped frame (tables 2 and 3).")
    ] = 2,
    tuning: Annotated[
        bool, typer.Option("--tuning", help="Only the families of scans used to tune the localizer.")
    ] = False,
    frames: Annotated[
        bool, typer.Option("--frames", help="Only the sets of the x-shaped frame (tables 2 and 3).")
    ] = False,
    thesis: Annotated[
        bool,
        typer.Option(
            "--thesis", help="Only the thesis protocol: 20 scans, 116 spheres, scanners with scale errors."
        ),
    ] = False,
    metal: Annotated[
        bool,
        typer.Option(
            "--metal", help="Only spheres on metal, with shadows and streaks from the physics of the scan."
        ),
    ] = False,
    series: Annotated[
        Path | None,
        typer.Option(
            "--series",
            metavar="DIR",
            help="Only spheres inserted into this CT of a head, --volumes times for each kind of post.",
        ),
    ] = None,
    families: Annotated[
        list[str] | None,
        typer.Option(
            "--family",
            metavar="NAME",
            help="Only this family of scans, without the x-shaped frame; repeatable.",
        ),
    ] = None,
    methods: OwnOption = None,
    *,
    study_options: StudyOptions,
) -> None:
    """Spheres in phantom CTs: error, detection and calibration of the predicted error, against the thesis."""
    from studies.localization import metal_study, series_study, tables, thesis_protocol
    from studies.localization.study import JUDGING, TUNING, LocalizationStudy

    if thesis + tuning + frames + metal + (series is not None) + bool(families) > 1:
        chosen = {
            "--thesis": thesis,
            "--tuning": tuning,
            "--frames": frames,
            "--metal": metal,
            "--series": series is not None,
            "--family": bool(families),
        }
        raise _several_studies([option for option, is_given in chosen.items() if is_given])
    if (thesis or metal or series is not None) and methods:
        with_own = "--thesis" if thesis else "--metal" if metal else "--series"
        raise UsageMistake(
            f"--method cannot be combined with {with_own}",
            expected="--family, --frames or neither",
            action="Omit one of the two.",
        )
    for family in families or ():
        if family not in JUDGING:
            raise UsageMistake(
                f"--family: there is no evaluation family {family!r}",
                expected=", ".join(JUDGING),
                action="Name one of them, or omit --family for all.",
            )
    own = _try_plugins("LOCALIZER", methods)
    seed = study_options.seed
    if thesis:
        _run(thesis_protocol.ThesisLocalizationStudy(seed), thesis_protocol, study_options)
        return
    if metal:
        _run(metal_study.MetalStudy(volumes, seed), metal_study, study_options)
        return
    if series is not None:
        series_study.measured_series(str(series.resolve()))  # refused before any worker starts
        _run(series_study.SeriesStudy(str(series.resolve()), volumes, seed), series_study, study_options)
        return
    study = LocalizationStudy(volumes, sets, seed, own=own)
    if tuning:
        study = replace(study, families=TUNING, name="localization-tuning")
    if frames:
        study = replace(study, volumes=0, families=(), name="localization-frames")
    if families:
        only = tuple(dict.fromkeys(families))
        study = replace(study, sets=0, families=only, name="localization-families")
    _run(study, tables, study_options)


@app.command()
@with_option_records
def strategies(
    arms: Annotated[
        int,
        typer.Option(
            "--arms", min=2, max=500, help="Random arms of parameter set S; few save little: poses take most."
        ),
    ] = 200,
    identified: Annotated[
        bool,
        typer.Option(
            "--identified", help="Only arms as identified by `ronna-arm calibrate`, spheres as in a case."
        ),
    ] = False,
    wrong: Annotated[
        bool,
        typer.Option(
            "--wrong",
            help="Only the prediction, on arms with effects that their model lacks.",
        ),
    ] = False,
    one_experiment: Annotated[
        bool,
        typer.Option(
            "--one-experiment",
            help="Only arms whose tool frame and CT are fitted to table 4: at most 40, tilted alike.",
        ),
    ] = False,
    learning: Annotated[
        bool,
        typer.Option(
            "--learning",
            help="Only `learning` against all others: three targets a case, arms as told, better, worse.",
        ),
    ] = False,
    methods: OwnOption = None,
    *,
    study_options: StudyOptions,
) -> None:
    """Localization strategies on random arms, against table 4 of the thesis; quality of the prediction."""
    separate = {
        "--identified": identified,
        "--wrong": wrong,
        "--one-experiment": one_experiment,
        "--learning": learning,
    }
    given = [option for option, chosen in separate.items() if chosen]
    if len(given) > 1:
        raise _several_studies(given)
    if given and methods:
        raise UsageMistake(
            f"--method cannot be combined with {given[0]}, which has its own strategies",
            action="Omit one of the two.",
        )
    seed = study_options.seed
    if wrong:
        from studies.strategies import unmodelled_arm_tables
        from studies.strategies.unmodelled_arm import UnmodelledArmStudy

        _run(UnmodelledArmStudy(arms, seed), unmodelled_arm_tables, study_options)
    elif learning:
        from studies.strategies import learning_tables
        from studies.strategies.learning import LearningStudy

        _run(LearningStudy(arms, seed), learning_tables, study_options)
    elif one_experiment:
        from studies.strategies import experiment_tables
        from studies.strategies.one_experiment import MOST_ARMS, OneExperimentStudy

        _run(OneExperimentStudy(min(arms, MOST_ARMS), seed), experiment_tables, study_options)
    elif identified:
        from studies.strategies import identified as identified_arms

        _run(identified_arms.IdentifiedStudy(arms, seed), identified_arms, study_options)
    else:
        from studies.strategies import tables
        from studies.strategies.study import StrategiesStudy

        own = _try_plugins("STRATEGY", methods)
        _run(
            StrategiesStudy(arms, seed, "strategies-own" if own else "strategies", own), tables, study_options
        )


@app.command(name="application-error")
@with_option_records
def application_error(
    arms: Annotated[
        int, typer.Option("--arms", min=1, max=500, help="Random arms of parameter set S.")
    ] = 200,
    *,
    study_options: StudyOptions,
) -> None:
    """Error at superficial and deep targets on random arms, against RONNA G3."""
    from studies import application_error as errors

    _run(errors.ApplicationErrorStudy(arms, study_options.seed), errors, study_options)


@app.command(name="error-parts")
@with_option_records
def error_parts(
    arms: Annotated[int, typer.Option("--arms", min=2, max=500, help="Random arms of parameter set S.")] = 40,
    *,
    study_options: StudyOptions,
) -> None:
    """The error at the target by registration and arm; against FRE, distance and joint travel."""
    from studies import error_parts as parts

    _run(parts.ErrorPartsStudy(arms, study_options.seed), parts, study_options)


@app.command()
@with_option_records
def worlds(
    cases: Annotated[int, typer.Option("--cases", min=1, help="Worlds to draw.")] = 100,
    scene: Annotated[
        str | None, typer.Option("--scene", help="mini or default; the seed of each is drawn. [mini]")
    ] = None,
    adversarial: Annotated[
        bool,
        typer.Option(
            "--adversarial",
            help="Changes that the looks show least and the target feels most, in both scenes, with any arm.",
        ),
    ] = False,
    quiet: Annotated[
        bool, typer.Option("--quiet", help="Nothing changes: any finding is a false one.")
    ] = False,
    only: Annotated[
        int | None, typer.Option("--only", min=0, metavar="K", help="Only this world, once more.")
    ] = None,
    *,
    study_options: StudyOptions,
) -> None:
    """Whole cases in worlds drawn at random, with one change in each, judged by the truth.

    Prints the worst. Exit code 1: an error beyond twice its limit without a finding, more than 5 % beyond
    once, or a finding where nothing changed; with --adversarial an error beyond twice its stated rms without
    a word, or with --quiet a case refused or in doubt.
    """
    from studies.worlds.adversarial import AdversarialStudy
    from studies.worlds.cases import CASE_FILE
    from studies.worlds.study import WorldsStudy
    from studies.worlds.world import MINI, SCENES

    if adversarial and scene is not None:
        raise UsageMistake(
            f"--scene {scene} cannot be combined with --adversarial, which draws two mini scenes for each "
            "default one",
            action="Omit one of the two.",
        )
    scene = scene or MINI
    if scene not in SCENES:
        raise UsageMistake(
            f"--scene: worlds are drawn for no scene {scene!r}",
            expected=" or ".join(SCENES),
            action="Name one of them, or omit --scene.",
        )
    seed, place = study_options.seed, Path()
    study: WorldsStudy | AdversarialStudy = WorldsStudy(cases, seed, place, scene, quiet)
    if adversarial:
        study = AdversarialStudy(cases, seed, place, quiet)
    study = replace(study, folder=study_options.out or Path("campaigns") / study.name)
    if only is not None:
        if isinstance(study, WorldsStudy) and (change := study.world(only).change) is not None:
            terminal.tell(change.script.rstrip())
        place = study.folder / f"only-{only}"
        found = study.run_world(only, place)
        terminal.print_json(json.loads((place / CASE_FILE).read_text(encoding="utf-8")))
        terminal.tell(f"{found.words}: {place}")
        return
    workers = min(study_options.workers or MOST_CASES_AT_ONCE, MOST_CASES_AT_ONCE)
    sums = _run(study, study, replace(study_options, workers=workers))
    _require_nothing_missed("missed", study.list_missed_goals(sums))


def _require_nothing_missed(said: str, missed: Sequence[str]) -> None:
    """End with exit code 1 if a study has missed anything."""
    if missed:
        terminal.tell(f"{said}: {'; '.join(missed)}")
        raise typer.Exit(EXIT_FAILED)


@app.command(name="low-cost")
@with_option_records
def low_cost(
    arms: Annotated[int, typer.Option("--arms", min=1, max=100, help="Random UR5 arms.")] = 10,
    targets: Annotated[
        int,
        typer.Option("--targets", min=2, max=500, help="Targets, each in three orientations."),
    ] = 100,
    frames: Annotated[
        int, typer.Option("--frames", min=2, max=1000, help="Tracker frames averaged for one look, at 20 Hz.")
    ] = 60,
    scans: Annotated[
        int, typer.Option("--scans", min=1, max=50, help="CT scans of the phantom; the first is registered.")
    ] = 5,
    coarse: Annotated[
        bool, typer.Option("--coarse", help="Scans of larger voxels, in a tenth of the time.")
    ] = False,
    over_the_wire: Annotated[
        bool,
        typer.Option(
            "--over-the-wire", help="Drive each arm through its simulated controller, instead of placing it."
        ),
    ] = False,
    *,
    study_options: StudyOptions,
) -> None:
    """A UR5 guided by a Polaris Vicra to targets of a CT (PAPER 2): open loop, and on the tracker's feedback.

    The thesis prints no figures of that paper: relations are judged. Exit code 1: one does not hold.
    """
    from studies.low_cost.preparation import load_or_prepare
    from studies.low_cost.study import LowCostStudy, study_name
    from studies.low_cost.tables import list_missed_relations

    folder = study_options.out or Path("campaigns") / study_name(over_the_wire=over_the_wire)
    require_output_folder(folder)
    with terminal.progress_bar("scans, tool and registration") as progress:
        prepared = load_or_prepare(
            folder, study_options.seed, scans, frames, coarse=coarse, progress=progress
        )
    study = LowCostStudy(arms, targets, study_options.seed, frames, prepared, over_the_wire)
    sums = _run(study, study, replace(study_options, out=folder))
    _require_nothing_missed("does not hold", list_missed_relations(sums))


@app.command()
@with_option_records
def surface(
    heads: Annotated[
        int,
        typer.Option(
            "--heads", min=1, max=10_000, help="Heads, each under all conditions; more continue a study."
        ),
    ] = 334,
    shifts: Annotated[
        int, typer.Option("--shifts", min=0, max=10_000, help="Scans with a third of the skin shifted.")
    ] = 100,
    kinds: Annotated[
        Kinds,
        typer.Option(
            "--kinds", help="Judged kinds of misfit, those that may be seen during development, or both."
        ),
    ] = Kinds.ALL,
    export: Annotated[
        Path | None,
        typer.Option(
            "--export", metavar="DIR", help="Only write the clouds and truths as files, for other programs."
        ),
    ] = None,
    *,
    study_options: StudyOptions,
) -> None:
    """Registration on the skin without markers: errors, their prediction, refusals, on heads with misfits.

    With the defaults about 10,000 registrations are judged, and 1,300 of two development kinds run beside.
    """
    from studies.surface import tables
    from studies.surface.study import SurfaceStudy

    name = SurfaceStudy.name if kinds is Kinds.ALL else f"{SurfaceStudy.name}-{kinds}"
    study = SurfaceStudy(heads, study_options.seed, shifts, kinds, name)
    if export is None:
        _run(study, tables, study_options)
        return
    from studies.surface.export import export_study

    require_output_folder(export)
    with terminal.progress_bar("clouds") as progress:
        count = export_study(study, export, progress)
    terminal.tell(f"{format_count(count, 'scan')} with truths: {export}")


def _several_studies(given: Sequence[str]) -> UsageMistake:
    """Return the error of options that each select another study."""
    return UsageMistake(
        f"{' and '.join(given)} are separate studies",
        expected="one of them",
        action=f"Omit {' or '.join(given)}, and run one after the other.",
    )


def _try_plugins(kind: str, names: list[str] | None) -> tuple[PluginMethod, ...]:
    if not names:
        return ()
    from studies.plugin_trial import try_in_subprocess
    from studies.plugins.contracts import MethodKind

    return tuple(try_in_subprocess(MethodKind[kind], name, terminal.tell) for name in dict.fromkeys(names))


def _run(
    study: Study, results: Results, study_options: StudyOptions, plots: Plots | None = None
) -> Mapping[str, Sums]:
    """Run a study, publish its results and return its sums; its plots are those of `results` by default."""
    from studies.campaign.folder import Ledger, publish
    from studies.campaign.study import add_up
    from studies.campaign.workers import run_study

    folder = study_options.out or Path("campaigns") / study.name
    require_output_folder(folder)
    ledger = Ledger(folder, study)
    if kept := len(ledger.finished):
        terminal.tell(f"resuming: {kept} of {len(study.units())} units are done in {folder}")
    if ledger.damaged:
        again = "its unit is rerun" if ledger.damaged == 1 else "their units are rerun"
        terminal.tell(f"{format_count(ledger.damaged, 'damaged line')} of {folder} left out, {again}")
    try:
        with terminal.progress_bar(study.name) as progress:
            run_study(
                study,
                ledger,
                workers=study_options.workers,
                scheduler=study_options.scheduler,
                progress=progress,
                tell=terminal.tell,
            )
    except KeyboardInterrupt:
        units = format_count(len(ledger.finished), "unit")
        terminal.tell(f"{units} kept in {folder}; the same command continues")
        raise
    sums = add_up(ledger.results())
    found = results.tables(sums)
    draw = plots or getattr(results, "plots", None)
    report = publish(folder, study.name, study.settings(), found, draw(sums) if draw else {})
    _print_tables(found, {"study": study.name, "report": str(report)}, as_json=study_options.as_json)
    if not study_options.as_json:
        terminal.tell(f"report: {report}")
    return sums


@app.command()
def figures(
    seed: Annotated[int, typer.Option("--seed", min=0, help="Seed of all random numbers.")] = 0,
    out: Annotated[
        Path, typer.Option("--out", metavar="DIR", help="New or existing folder for the pictures.")
    ] = Path("campaigns/figures"),
) -> None:
    """Draw the thesis' figures 4, 5, 6 and 11, each from a run; others are in reports and studies."""
    from ronna_hw.records import write_atomically
    from studies.thesis_figures import figures as draw

    require_output_folder(out)
    out.mkdir(parents=True, exist_ok=True)
    for name, picture in draw(seed).items():
        write_atomically(out / name, picture)
        terminal.tell(str(out / name))


@app.command()
def equations(
    seed: Annotated[int, typer.Option("--seed", min=0, help="Seed of all random numbers.")] = 0,
    out: Annotated[
        Path, typer.Option("--out", metavar="DIR", help="New or existing folder for the tables.")
    ] = Path("campaigns/equations"),
    as_json: terminal.JsonOption = False,
) -> None:
    """Evaluate the thesis' equations, and the figures printed below its tables, by other ways to the same."""
    from studies.campaign.folder import publish
    from studies.thesis_equations import tables

    require_output_folder(out)
    out.mkdir(parents=True, exist_ok=True)
    found = tables(seed)
    report = publish(out, "equations", {"seed": seed}, found, {})
    _print_tables(found, {"report": str(report)}, as_json=as_json)
    if not as_json:
        terminal.tell(f"report: {report}")


@app.command()
def times(
    runs: Annotated[list[Path], typer.Argument(metavar="RUN...", help="Folders of runs.")],
    as_json: terminal.JsonOption = False,
) -> None:
    """Where the time of runs went: phases, steps, people; against the times of the thesis."""
    from procedures.runs.folders import require_run
    from ronna_hw.evidence.inspection import inspect_run
    from studies.times import time_tables

    for run in runs:
        require_run(run)
        inspect_run(run, every_file=False).require_unchanged()
    _print_tables(time_tables(runs), {"runs": len(runs)}, as_json=as_json)


@app.command()
def notebook(
    notebooks: Annotated[list[Path], typer.Argument(metavar="FILE...", help="Notebooks to execute.")],
    out: Annotated[
        Path,
        typer.Option(
            "--out", metavar="DIR", help="Folder in which they run, and to which they are written executed."
        ),
    ] = Path("notebooks"),
) -> None:
    """Execute notebooks, such as those in examples/notebooks, without Jupyter; needs the extra notebooks."""
    from studies.notebooks import execute_notebook

    require_output_folder(out)
    for path in notebooks:
        terminal.tell(str(execute_notebook(path, out)))


def _print_tables(found: Sequence[Table], head: Mapping[str, object], *, as_json: bool) -> None:
    from studies.campaign.study import format_cell

    if as_json:
        terminal.print_json({**head, "tables": [table.document() for table in found]})
        return
    for table in found:
        rows = [[format_cell(value) for value in row] for row in table.rows]
        terminal.print_table(table.title, list(table.columns), rows)


def main() -> None:
    terminal.run(app)


if __name__ == "__main__":
    main()
