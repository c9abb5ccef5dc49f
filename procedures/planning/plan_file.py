"""The plan file `plan.toml`: create, read, write and seal. All mistakes in a file are reported together.

Values typical of metres or centimetres are refused in files and in the planner, but not in records, which
must stay readable. A seal states who saved a plan, on which voxels, and that it has not been altered since.
"""

from __future__ import annotations

import hashlib
import json
from collections import Counter
from collections.abc import Iterable, Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

from pydantic import ValidationError

from procedures.planning.errors import (
    ALTERED_PLAN,
    BAD_TRAJECTORY_GEOMETRY,
    DUPLICATE_TRAJECTORY,
    PLAN_NOT_SAVED,
    PLAN_UNREADABLE,
    AcPcUnfit,
    OtherVoxels,
    PlanError,
    PlanMistakes,
    raise_together,
)
from procedures.planning.plan_model import (
    FEWEST_MARKERS,
    MOST_MARKERS,
    NOT_METRES,
    SCHEMA_VERSION,
    PatientPosition,
    Plan,
    Seal,
    Structure,
    is_in_metres,
    span,
)
from procedures.planning.structures import LEAST_MARGIN_MM
from ronna_hw.bounded_input import parse_toml_bytes, read_toml
from ronna_hw.errors import AnyCode
from ronna_hw.mistakes import describe_mistakes, find_other_kind, mistakes_in
from ronna_hw.records import canonical_json, write_atomically
from ronna_hw.text import printable

if TYPE_CHECKING:
    from procedures.imaging.volume import Volume

PLAN_FILE = "plan.toml"  # of the folder of a case, beside its `ct`
GIVE_A_PLAN = "Give the path of a plan.toml that can be read."
LEAST_GAP_MM = 1.0  # between skin and guide; 0 is a guide that touches it
LEAST_TARGET_MARGIN_MM = 0.05  # a third of the smallest predicted error
UNSEALED = "0" * 64  # replaces a plan's digest while that is computed
# Noun for an item of a list, and the key of its name.
NAMED = {"trajectories": ("trajectory", "id"), "structures": ("structure", "name")}
GEOMETRY_ERRORS: dict[str, AnyCode[PlanError]] = {
    "trajectory_geometry": BAD_TRAJECTORY_GEOMETRY,
    "ac_pc_geometry": AcPcUnfit,
}
# Keys that plans of earlier versions lack, with advice.
ADDED = {
    "trajectories": "add one with `ronna-plan open CT_DIR --plan FILE`, or a block [[trajectories]] with id, "
    "entry_mm, target_mm, free_angle_deg and margin_mm",
    "standoff_mm": "add `standoff_mm = 30.0`: from the entry to the lower end of the guide, outside the skin",
    "instrument_length_mm": "add `instrument_length_mm = 250.0`: its length from the tip to the end that "
    "still holds a depth stop, as on its packaging",
}
UNKNOWN_POSITION = f"# patient_orientation: not given by the series; one of {', '.join(PatientPosition)}"
TRAJECTORY = """
# One block for each trajectory, in the order in which they are meant to be done; take the # away.
# [[trajectories]]
# id = "T1"
# entry_mm = [0.0, 0.0, 0.0]   # where it enters the head
# target_mm = [0.0, 0.0, 0.0]  # where it ends
# free_angle_deg = 0.0         # of the guide about the axis
# margin_mm = 2.0              # largest target error that is accepted
"""


def read_plan(path: Path, *, sealed_only: bool = True) -> Plan:
    """Read and check a plan. Raises PLAN-001 and the errors of `parse_plan`, listing every mistake."""
    path = Path(path)
    if path.is_dir():
        inside = [one for one in (path / PLAN_FILE, path / "case" / PLAN_FILE) if one.is_file()]
        raise PLAN_UNREADABLE(
            f"{path} is a folder, not a plan",
            expected="a plan file",
            action=f"Give the plan in it: {inside[0]}." if inside else GIVE_A_PLAN,
        )
    try:
        content = read_toml(path, PLAN_UNREADABLE)
    except OSError as error:
        raise PLAN_UNREADABLE(f"cannot read {path}: {error.strerror}", action=GIVE_A_PLAN) from error
    return parse_plan(content, path.name, sealed_only=sealed_only)


def parse_plan_bytes(content: bytes, name: str) -> Plan:
    """Parse the content of a plan file with this name. Raises like `read_plan`."""
    return parse_plan(parse_toml_bytes(content, name, PLAN_UNREADABLE), name)


def parse_plan(content: dict[str, Any], name: str = "the plan", *, sealed_only: bool = True) -> Plan:
    """Check the content of a plan. Raises PLAN-002, 004, 005, 023 and 031, listing every mistake.

    Without `sealed_only`, a plan altered since it was sealed is still read, for viewing.
    """
    if not content:
        raise PLAN_UNREADABLE(f"{name} is empty", action="Put it back from a copy, or write it anew.")
    if other := find_other_kind(content, "trajectories"):
        raise PLAN_UNREADABLE(f"{name} is {other}, not a plan", action=GIVE_A_PLAN)
    found: list[PlanError] = []
    plan: Plan | None = None
    try:
        # TOML has lists where the model has tuples, text where it has enums; strict JSON mode accepts both.
        plan = Plan.model_validate_json(json.dumps(content, default=str))
    except ValidationError as error:
        lines = describe_mistakes(error, Plan)
        for mistake, line in zip(mistakes_in(error), lines, strict=False):
            kind = GEOMETRY_ERRORS.get(mistake["type"], PlanMistakes)
            message = _name_item(line, mistake["loc"], content) + _advise_missing_key(mistake)
            found.append(kind(message))
    found += [
        DUPLICATE_TRAJECTORY(f"{count} trajectories have the id {identifier!r}")
        for identifier, count in _count_ids(content).items()
        if count > 1
    ]
    found += [] if plan is None else find_unit_mistakes(plan)
    if len(found) == 1:
        raise found[0].reworded(f"{name}: {found[0].what}")
    raise_together(found, name)
    if plan is None:
        raise PlanMistakes(f"{name} is not a plan")
    if sealed_only:
        require_unaltered(plan, name)
    return plan


def write_plan(path: Path, plan: Plan, notes: Iterable[str] = ()) -> None:
    """Write a plan atomically, preceded by `notes` as comments. Raises PLAN-025."""
    import tomli_w

    head = "".join(f"# {printable(line)}\n" for line in notes)
    content = plan.model_dump(mode="json", by_alias=True, exclude_none=True)
    try:
        write_atomically(path, (head + tomli_w.dumps(content)).encode())
    except OSError as error:
        raise PLAN_NOT_SAVED(f"cannot write {path.name}: {error.strerror}") from error


def _name_item(line: str, place: tuple[int | str, ...], content: dict[str, Any]) -> str:
    """Replace the index of a trajectory or structure in a line with its name or number."""
    match place:
        case ("trajectories" | "structures" as table, int(index), *_):
            kind, key = NAMED[table]
            row = content[table][index]
            name = row.get(key) if isinstance(row, dict) else None
            known = f"{kind} {printable(name)}" if isinstance(name, str) and name else f"{kind} {index + 1}"
            return line.replace(f"{table} {index + 1}", known, 1)
    return line


def _advise_missing_key(mistake: Mapping[str, Any]) -> str:
    key = str(mistake["loc"][-1]) if mistake["loc"] else ""
    return f"; {ADDED[key]}" if mistake["type"] == "missing" and key in ADDED else ""


def _count_ids(content: dict[str, Any]) -> Counter[str]:
    """Count the trajectory ids in the raw content, since other mistakes may prevent parsing the model."""
    rows = content.get("trajectories")
    if not isinstance(rows, list):
        return Counter()
    return Counter(row["id"] for row in rows if isinstance(row, dict) and isinstance(row.get("id"), str))


def find_unit_mistakes(plan: Plan) -> list[PlanMistakes]:
    """List plan values that suggest a unit error."""
    found = [
        PlanMistakes(
            f"trajectory {one.id}.margin_mm: {one.margin_mm:g} mm is less than any case can achieve: "
            f"{NOT_METRES}, and at least {LEAST_TARGET_MARGIN_MM:g}"
        )
        for one in plan.trajectories
        if one.margin_mm < LEAST_TARGET_MARGIN_MM
    ]
    found += [mistake for one in plan.structures or () for mistake in find_structure_unit_mistakes(one)]
    if 0.0 < plan.standoff_mm < LEAST_GAP_MM:
        found.append(
            PlanMistakes(f"standoff_mm: {plan.standoff_mm:g} mm is closer than a guide is held: {NOT_METRES}")
        )
    deepest = max(plan.trajectories, key=lambda one: one.depth_mm)
    needed_mm = deepest.depth_mm + plan.standoff_mm
    if plan.instrument_length_mm < needed_mm:
        found.append(
            PlanMistakes(
                f"instrument_length_mm is {plan.instrument_length_mm:g}, but {deepest.id} needs more than "
                f"{needed_mm:.1f} mm: {deepest.depth_mm:.1f} mm from entry to target, {plan.standoff_mm:g} "
                "mm of stand-off, and the guide; give millimetres, not centimetres"
            )
        )
    return found


def find_structure_unit_mistakes(structure: Structure) -> list[PlanMistakes]:
    """List structure values that suggest a unit error."""
    found = []
    if structure.margin_mm < LEAST_MARGIN_MM:
        found.append(
            PlanMistakes(
                f"structure {structure.name}.margin_mm: {structure.margin_mm:g} mm is less than half the "
                f"thickness of any instrument: {NOT_METRES}, and at least {LEAST_MARGIN_MM:g}"
            )
        )
    if is_in_metres(structure.points_mm):
        found.append(
            PlanMistakes(
                f"structure {structure.name}.points_mm: all within {span(structure.points_mm):.3g} mm of "
                f"each other: {NOT_METRES}"
            )
        )
    return found


def seal_plan(plan: Plan, author: str, volume: Volume) -> Plan:
    """Return the sealed plan. Raises pydantic's ValidationError for an invalid author."""
    open_seal = Seal(author=author, ct_sha256=ct_digest(volume), plan_sha256=UNSEALED)
    digest = _plan_digest(plan.model_copy(update={"seal": open_seal}))
    return plan.model_copy(update={"seal": open_seal.model_copy(update={"plan_sha256": digest})})


def describe_seal(plan: Plan) -> str:
    """Say who sealed a plan, or that nothing says who made it."""
    if plan.seal is None:
        return "not sealed: nothing says who made or altered it"
    return f"sealed by {plan.seal.author}"


def require_unaltered(plan: Plan, name: str) -> None:
    """Raise PLAN-023 if a plan does not match its seal."""
    if plan.seal is not None and plan.seal.plan_sha256 != _plan_digest(plan):
        raise ALTERED_PLAN(f"{name} was altered after {plan.seal.author} saved it")


def check_voxels(plan: Plan, volume: Volume) -> OtherVoxels | None:
    """Return a finding if a sealed plan was made on different voxels, otherwise None."""
    if plan.seal is None:
        return None
    digest = ct_digest(volume)
    if digest == plan.seal.ct_sha256:
        return None
    return OtherVoxels(
        "the CT is not the one that the plan was made on, although it has the same UID",
        expected=plan.seal.ct_sha256[:12],
        got=digest[:12],
    )


def ct_digest(volume: Volume) -> str:
    """Return the SHA-256 of a CT's voxels and geometry."""
    geometry = volume.geometry
    place = {
        "series": volume.series_instance_uid,
        "position": volume.patient_position,
        "shape": list(geometry.shape),
        "origin_mm": geometry.origin_mm.tolist(),
        "axes": geometry.axes.tolist(),
        "spacing_mm": geometry.spacing_mm.tolist(),
    }
    digest = hashlib.sha256(canonical_json(place))
    for one in volume.voxels:  # slice by slice, without copying the whole
        digest.update(one.astype("<i2", order="C", copy=False).data)
    return digest.hexdigest()


def _plan_digest(plan: Plan) -> str:
    assert plan.seal is not None
    without_digest = plan.model_copy(update={"seal": plan.seal.model_copy(update={"plan_sha256": UNSEALED})})
    content = without_digest.model_dump(mode="json", by_alias=True, exclude_none=True)
    return hashlib.sha256(canonical_json(content)).hexdigest()


def compose_plan(
    series_instance_uid: str, patient_position: str, spheres_mm: Sequence[Sequence[float]], source: str
) -> str:
    """Compose a new plan file for the series `source`, with its spheres (n, 3) LPS mm as comments."""
    return "\n".join(_compose_lines(series_instance_uid, patient_position, spheres_mm, source)) + TRAJECTORY


def _compose_lines(
    series_instance_uid: str, patient_position: str, spheres_mm: Sequence[Sequence[float]], source: str
) -> Iterable[str]:
    yield f"# Created from the CT in {source}. Coordinates are LPS mm of that series."
    yield "# Every key: docs/reference/plan-file.md. Then: ronna-plan check PLAN --ct SERIES_DIR"
    yield f"schema = {SCHEMA_VERSION}"
    yield f'series_instance_uid = "{series_instance_uid}"'
    if patient_position in set(PatientPosition):
        yield f'patient_orientation = "{patient_position}"  # from the series'
    else:
        yield UNKNOWN_POSITION
    count = len(spheres_mm)
    known = FEWEST_MARKERS <= count <= MOST_MARKERS
    found = f"{count} found in the CT; count the screws on the patient"
    yield f"implanted = {count}  # {found}" if known else f"# implanted = ...  # {found}"
    yield 'fiducials = "free"  # or "xframe"'
    yield 'tool = "guide"'
    yield "standoff_mm = 30.0  # from the entry to the lower end of the guide, outside the skin"
    yield "# instrument_length_mm = 250.0  # from its tip to where a depth stop still holds"
    for number, centre in enumerate(spheres_mm, start=1):
        yield f"# sphere {number}: {', '.join(f'{value:.2f}' for value in centre)}"
