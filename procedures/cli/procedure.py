"""`ronna-procedure`: run or step through a case; show steps, state chart and device links."""

from __future__ import annotations

import sys
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

from typer import Option

from procedures.cli.calibrating.mount import app as calibrate_app
from procedures.cli.case.options import (
    CaseOptions,
    ConfigOption,
    ConsoleOptions,
    FiducialChoice,
    LinkOptions,
    StartOption,
)
from procedures.cli.monitor import monitor
from procedures.cli.new_theatre.command import new_theatre
from procedures.cli.runs.commands import add_commands
from procedures.cli.theatre_history import theatre_history
from procedures.engine.methods import HeadStart
from ronna_hw.command_line import terminal
from ronna_hw.command_line.options import with_option_records
from ronna_hw.host.process import resume_garbage_collection, suspend_garbage_collection
from ronna_hw.roles import roles_of

if TYPE_CHECKING:
    from procedures.engine.order import Steps

DualOption = Annotated[bool, Option("--dual", help="Of a case with two arms.")]
FiducialsOption = Annotated[
    FiducialChoice, Option(help="Of a case that registers by these; surface and mixed scan the skin.")
]

app = terminal.command_group(
    "ronna-procedure",
    "The procedure of a frameless stereotactic robot, from the CT to the needle tip. "
    "Research software, not a medical device.",
    example="ronna-procedure run --sim",
)


@app.command("run")
@with_option_records
def run_command(
    case: CaseOptions, console: ConsoleOptions, link: LinkOptions, as_json: terminal.JsonOption = False
) -> None:
    """Run the whole case; ends with the errors at the targets and a report."""
    suspend_garbage_collection()  # until the engine is built
    try:
        from procedures.cli.case.display import follow_case

        request, page, served = case.request(), console.request(), link.served_at()
        archive = link.through_archive(case)
        follow_case(request, case.out, as_json=as_json, console=page, openigtlink=served, archive=archive)
    finally:
        resume_garbage_collection()


@app.command("step")
@with_option_records
def step_command(case: CaseOptions, console: ConsoleOptions) -> None:
    """Step through the case by hand, one command per line; help lists them."""
    from procedures.cli.case.stepping import step_through

    step_through(replace(case.request(), by_step=True), case.out, console.request())


@app.command("steps")
def steps_command(
    dual: DualOption = False,
    fiducials: FiducialsOption = FiducialChoice.FREE,
    start: StartOption = HeadStart.LANDMARKS,
    as_json: terminal.JsonOption = False,
) -> None:
    """List the steps of the procedure, what each one needs and what it may ask."""
    from procedures.engine.order import Scope
    from procedures.steps.catalogue import list_questions

    steps = _steps_of(dual=dual, fiducials=fiducials, start=start)
    if as_json:
        rows = []
        for step in steps:
            asked = list_questions(step)
            asks = [{"topic": one.topic, "answers": list(one.answers), "if": one.condition} for one in asked]
            plain = {"name": step.name, "title": step.title, "needs": list(step.needs)}
            kind = {"per_trajectory": step.scope is not Scope.CASE, "moves": step.moves_an_arm}
            rows.append({**plain, **kind, "asks": asks})
        terminal.print_json({"steps": rows})
        return
    headings = ("step", "what it does", "for each trajectory", "moves an arm", "needs", "asks")
    table = []
    for step in steps:
        marks = ("" if step.scope is Scope.CASE else "yes", "yes" if step.moves_an_arm else "")
        topics = ", ".join(dict.fromkeys(one.topic for one in list_questions(step)))
        table.append((step.name, step.title, *marks, ", ".join(step.needs), topics))
    terminal.print_table("Steps of the procedure", headings, table)


@app.command("graph")
def graph_command(
    dual: DualOption = False,
    fiducials: FiducialsOption = FiducialChoice.FREE,
    start: StartOption = HeadStart.LANDMARKS,
) -> None:
    """Print the state chart of the procedure as mermaid text."""
    from procedures.engine.machine import state_chart_mermaid

    sys.stdout.write(state_chart_mermaid(_steps_of(dual=dual, fiducials=fiducials, start=start)))


def _steps_of(*, dual: bool, fiducials: FiducialChoice, start: HeadStart) -> Steps:
    """Return the steps of a case. Raises CLI-001 for choices that cannot be combined."""
    from procedures.engine.methods import CaseMethods
    from procedures.planning.plan_model import FiducialKind
    from procedures.runs.request import CaseProcedure
    from procedures.runs.request_checks import require_one_change
    from procedures.steps.catalogue import clinical_steps

    roles, kind = roles_of(dual=dual), FiducialKind(fiducials.value)
    require_one_change(CaseProcedure(roles=roles, methods=CaseMethods(start=start)), kind)
    return clinical_steps(roles=roles, fiducials=kind, start=start)


@app.command("doctor")
def doctor_command(
    config: ConfigOption = None,
    endpoint: Annotated[
        list[str] | None,
        Option(
            "--endpoint",
            help="A tracker's line, a controller's EKI server or Universal Robots service, or a camera to "
            "check: serial:///dev/..., tcp://host:port or gev://host. Servers that do not speak first are "
            "sent a tracker's inquiry, at 30004 one of RTDE.",
        ),
    ] = None,
    out: Annotated[Path, Option(help="Folder for runs, whose disk is judged.")] = Path("runs"),
    everything: Annotated[bool, Option("--all", help="Also list the checks without a finding.")] = False,
    as_json: terminal.JsonOption = False,
) -> None:
    """Check this computer and, with --config, every device of a theatre file with its driver's own probe.

    A tracker's line is tried at every rate without changing anything: which unit replies, which bytes arrive,
    which program holds the port. A camera's address: which cameras are on its network, which application
    controls it, which packet size arrives. Ends with a verdict for each device and one for a case, which
    names whatever `run` would refuse. Tracker and cameras are switched on for this; nothing moves. Exit
    codes: 0 everything is ready, 4 a device, line, camera or the theatre's clock does not answer or is not
    ready, or a calibration record has expired, 3 the case is not ready for another reason, or an endpoint is
    of a theatre that is in use.
    """
    from procedures.cli.doctor.report import examine, show

    with terminal.progress_bar("probing the devices") as progress:
        report = examine(config, endpoint or (), progress, out=out)
    show(report, as_json=as_json, everything=everything)


add_commands(app)
app.add_typer(calibrate_app, name="calibrate")
app.command("monitor")(monitor)
app.command("new-theatre")(new_theatre)
app.command("theatre-history")(theatre_history)


def main() -> None:
    terminal.run(app)


if __name__ == "__main__":
    main()
