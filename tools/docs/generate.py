"""Generator of the reference tables, which follow a mark below each page's hand-written text.

`make docs` runs it; a test compares the committed pages with its output.
"""

from __future__ import annotations

import importlib
import pkgutil
import re
import sys
from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from types import ModuleType

from api_pages import devices, numerics, runs
from command_table import command_table, option_table
from hazard_matrix import hazard_table
from kept_tables import write_pages
from model_tables import model_tables
from reference_tables import (
    REFERENCE,
    ROOT,
    checklist,
    disturbances,
    parameter_table,
    robot_parameters,
    scanner_faults,
    table,
    vendor_tests,
)
from safety_figures import safety_table
from strangers_table import strangers
from time_table import time_table

import conformance
import console
import drivers
import procedures.steps
import ronna_hw
import sim
import studies
from conformance import robot, stereo, tracker
from drivers.basler_stereo.options import BaslerOptions
from drivers.kuka_rsi import options as kuka_rsi
from drivers.ndi_polaris.options import PolarisOptions
from drivers.openigtlink_tracker.options import OpenIGTLinkOptions
from drivers.universal_robots import options as universal_robots
from procedures.engine.machine import state_chart_mermaid
from procedures.exchange import allowed_fields
from procedures.journal.results import StepResult
from procedures.operator.question import FOR_A_PERSON, Topic, join_answers
from procedures.planning.plan_model import Plan
from procedures.steps.branches import BRANCHES
from procedures.steps.catalogue import ANSWER_WORDS, clinical_steps
from ronna_hw.arm_stream.errors import StreamErrors
from ronna_hw.config import Role, TheatreFile
from ronna_hw.errors import AnyCode, ErrorCode, RonnaError, coded_classes
from ronna_hw.roles import TWO_ARMS
from sim.named_parameters import rows
from sim.polaris.unit.behaviour import UnitBehaviour
from sim.universal_robots.controller_parameters import ControllerParameters
from sim.world.faults import FAULT_KINDS, FaultKind
from sim.world.faults.universal_robots import UR_FAULTS
from sim.world.scene.model import Scene

PACKAGES: tuple[ModuleType, ...] = (ronna_hw, conformance, drivers, sim, procedures, studies, console)
CASE_STEPS = clinical_steps(measure_targets=True, intraoperative=True, roles=TWO_ARMS)
MOST_PLACES = 3  # of an error, in its table: beyond that it is one of many
_RAISED = re.compile(r"(?<!class )\b([A-Z]\w*(?:\.(?!from_)\w+)?)(?:\.from_\w+)?\(")
MARK = "<!-- below this line: written by tools/docs/generate.py; do not edit -->\n\n"


def tables() -> dict[str, str]:
    """Return the generated content of each page, by file name."""
    return {
        "answers.md": table(
            ("topic", "words", "on real devices"),
            [
                (
                    f"`{topic}`",
                    join_answers(ANSWER_WORDS[topic]),
                    "only a person" if topic in FOR_A_PERSON or topic is Topic.PATIENT else "",
                )
                for topic in Topic
            ],
        ),
        "api-devices.md": devices(),
        "api-numerics.md": numerics(),
        "api-runs.md": runs(),
        "camera-checklist.md": checklist(stereo.SUITE, "gige-vision"),
        "commands.md": command_table(),
        "error-codes.md": _tabulate_error_codes(),
        "export.md": _tabulate_exported_fields(),
        "faults.md": _tabulate_faults(FAULT_KINDS),
        "hazards.md": hazard_table(),
        "link-disturbances.md": disturbances(),
        "plan-file.md": model_tables({"plan": Plan}),
        "polaris-checklist.md": checklist(tracker.SUITE, "ndi-polaris"),
        "records.md": model_tables({model.kind: model for model in list_step_results()}),
        "robot-checklist.md": checklist(robot.SUITE, "kuka-rsi-eki"),
        "robot-options.md": _tabulate_roles(kuka_rsi.ROLES) + model_tables({"Options": kuka_rsi.KukaOptions}),
        "robot-parameters.md": robot_parameters(),
        "scene-file.md": model_tables({"scene": Scene}),
        "safety-figures.md": safety_table(),
        "scanner-faults.md": scanner_faults(),
        "strangers.md": strangers(),
        "state-chart.md": f"```mermaid\n{state_chart_mermaid(CASE_STEPS)}```\n\n{_tabulate_branches()}",
        "stereo-options.md": model_tables({"Options": BaslerOptions}),
        "ur-options.md": _tabulate_roles(universal_robots.ROLES)
        + model_tables({"Options": universal_robots.UrOptions}),
        "theatre-file.md": model_tables({"theatre file": TheatreFile}),
        "openigtlink-tracker-options.md": model_tables({"Options": OpenIGTLinkOptions}),
        "tracker-options.md": model_tables({"Options": PolarisOptions}),
        "tracker-parameters.md": parameter_table(rows(UnitBehaviour)),
        "ur-simulator.md": _describe_ur_simulator(),
        "../explanation/where-the-time-goes.md": time_table(),
    }


def _tabulate_roles(roles: Mapping[str, Role]) -> str:
    rows = [(f"`{name}`", f"`{role.example}`", role.purpose) for name, role in roles.items()]
    return (
        "## Endpoints\n\nTable `[robot.<name>.endpoints]`; all are required.\n\n"
        f"{table(('role', 'for example', 'what passes there'), rows)}\n"
    )


def with_table(page: str, content: str) -> str:
    """Return the page with the content below its mark replaced."""
    return page.partition(MARK)[0] + MARK + content


def list_step_results() -> list[type[StepResult]]:
    """List all step results: those of a case in order, then those of calibrations by name."""
    for module in pkgutil.walk_packages(procedures.steps.__path__, "procedures.steps."):
        importlib.import_module(module.name)
    ours = [model for model in StepResult.__subclasses__() if model.__module__.startswith("procedures.")]
    case = [step.result for step in CASE_STEPS]
    return [*case, *sorted(set(ours) - set(case), key=lambda model: model.kind)]


@dataclass(frozen=True)
class ListedError:
    """Error of the reference, with the name by which it is raised and the module that has it."""

    name: str
    module: str
    meaning: str
    entry: AnyCode[RonnaError]

    @property
    def code(self) -> str:
        return self.entry.code

    @property
    def action(self) -> str:
        """Advice that its message ends with."""
        return self.entry.action


def list_errors_with_code() -> list[ListedError]:
    """List all errors that have a code, sorted by code."""
    ours = {package.__name__ for package in PACKAGES}  # tests define errors of their own
    for package in PACKAGES:
        for module in pkgutil.walk_packages(package.__path__, package.__name__ + "."):
            # ronna_hw defines its few errors where they are raised; every other package has an errors.py.
            if module.name.endswith("errors") or (package is ronna_hw and ".cli" not in module.name):
                importlib.import_module(module.name)
    found = [
        ListedError(one.__name__, one.__module__, (one.__doc__ or "").strip().splitlines()[0], one)
        for one in coded_classes()
        if one.__module__.partition(".")[0] in ours
    ]
    # A row is where it was made, and has the first name there: errors.py of a package imports few of others.
    places = sorted((name for name in sys.modules if name.partition(".")[0] in ours), key=_is_importer)
    rows: dict[str, ListedError] = {}
    for place in places:
        for name, entry in vars(sys.modules[place]).items():
            named = {name: entry}
            if isinstance(entry, StreamErrors):
                named = {f"{name}.{row}": error for row, error in entry.rows().items()}
            for called, row in named.items():
                if isinstance(row, ErrorCode):
                    rows.setdefault(row.code, ListedError(called, place, row.meaning, row))
    return sorted([*found, *rows.values()], key=lambda error: error.code)


def _is_importer(module: str) -> bool:
    return not module.endswith("errors")


def _tabulate_faults(kinds: Iterable[FaultKind]) -> str:
    return table(
        ("fault", "", "effect"),
        [(f"`{kind.usage}`", "once" if kind.momentary else "lasts", kind.meaning) for kind in kinds],
    )


def _describe_ur_simulator() -> str:
    sections = {
        "Options": option_table("ronna-sim", "ur"),
        "Faults": _tabulate_faults(UR_FAULTS),
        "Parameters": "No public source settles these: `--set NAME=VALUE` changes the behaviour.\n\n"
        + parameter_table(rows(ControllerParameters)),
        "The vendor's own tests": vendor_tests(),
    }
    return "\n".join(f"## {title}\n\n{content}" for title, content in sections.items())


def _tabulate_error_codes() -> str:
    raised: dict[str, tuple[set[str], str]] = {}
    for package in PACKAGES:
        for path in sorted((ROOT / package.__name__).rglob("*.py")):
            text = path.read_text(encoding="utf-8")
            raised[str(path.relative_to(ROOT))] = set(_RAISED.findall(text)), text
    return table(
        ("code", "what it means", "what to do", "raised in", "exit code"),
        [
            (
                error.code,
                error.meaning,
                error.action,
                _name_places(error, raised),
                error.entry.exit_code,
            )
            for error in list_errors_with_code()
        ],
    )


def _name_places(error: ListedError, raised: Mapping[str, tuple[set[str], str]]) -> str:
    """Name the modules that raise an error, at most `MOST_PLACES`.

    Those of two drivers may have the same name: only modules that import this one count, and its own.
    """
    own = f"{error.module.replace('.', '/')}.py"
    package, _, module = error.module.rpartition(".")
    imported = re.compile(rf"from {error.module} import|from {package} import (\([^)]*|[^\n(]*)\b{module}\b")
    places = [
        f"`{name}`"
        for name, (errors, text) in raised.items()
        if error.name in errors and (name == own or imported.search(text))
    ]
    if error.name.startswith("STREAM_ERRORS."):
        places.append("`ronna_hw/arm_stream`")
    more = f" and {len(places) - MOST_PLACES} more" if len(places) > MOST_PLACES else ""
    return ", ".join(places[:MOST_PLACES]) + more


def _tabulate_exported_fields() -> str:
    """Tabulate the files of an export and the fields that may leave a run folder in them."""
    files = table(("file", "holds"), [(f"`{name}`", what) for name, what in allowed_fields.FILES.items()])
    columns = [
        f"## Columns of `{name}`\n\n"
        + table(("column", "type", ""), [(f"`{one.name}`", one.kind, one.meaning) for one in listed])
        for name, listed in allowed_fields.TABLES.items()
    ]
    rows = [
        (f"`{name}`", record_name, meaning)
        for record_name, fields in (
            ("spheres", allowed_fields.SPHERE_FIELDS),
            ("registrations", allowed_fields.REGISTRATION_FIELDS),
            ("all", allowed_fields.DOCUMENT_FIELDS),
            ("index", allowed_fields.INDEX_FIELDS),
        )
        for name, meaning in fields.items()
    ]
    fields = table(("field", "in", ""), rows)
    attributes = [(f"`{name}`", "") for name in allowed_fields.FILLED_ATTRIBUTES]
    identity = "empty; that of the CT with --identity-from"
    attributes += [
        (f"`{name}`", identity if name in allowed_fields.IDENTITY else "always empty")
        for name in allowed_fields.EMPTY_ATTRIBUTES
    ]
    return "\n".join(
        (
            f"## Files\n\n{files}",
            *columns,
            f"## Fields of the JSON files and of the markups' heads\n\n{fields}",
            f"## Attributes of the DICOM objects\n\n{table(('attribute', ''), attributes)}",
        )
    )


def _tabulate_branches() -> str:
    """Tabulate the decision points and failure branches."""
    return table(
        ("what happens", "in", "noticed by", "then", "ends in", "question", "code"),
        [
            (
                one.event,
                ", ".join(one.steps) or "any step",
                one.detected_by,
                one.action,
                one.ending,
                f"`{one.topic}`: {join_answers(one.answers)}" if one.topic and one.answers else "",
                ", ".join(error.code for error in one.errors),
            )
            for one in BRANCHES
        ],
    )


if __name__ == "__main__":
    for name, content in tables().items():
        path = REFERENCE / name
        path.write_text(with_table(path.read_text(encoding="utf-8"), content), encoding="utf-8")
    write_pages()
