"""Choices and shared options of the commands, importable without heavy dependencies."""

from __future__ import annotations

from enum import StrEnum
from functools import cached_property
from pathlib import Path
from typing import Annotated

import typer


class CycleMs(StrEnum):
    """Sensor cycle of a KUKA controller: #IPO_FAST or #IPO."""

    FAST = "4"
    SLOW = "12"


class InstrumentKind(StrEnum):
    """Kinds of instrument in a postoperative scan."""

    ELECTRODE = "electrode"
    NEEDLE = "needle"
    DRILL_HOLE = "drill-hole"


class Carrier(StrEnum):
    """Fiducials of a named scene: spheres on screws or on a frame, the skin, or the skin and few spheres."""

    FREE = "free"
    XFRAME = "xframe"
    SURFACE = "surface"
    MIXED = "mixed"


class ArmRole(StrEnum):
    """Role of an arm, as the theatre file names it."""

    MASTER = "master"  # carries stereo head and guide; its base is the robot frame
    ASSISTANT = "assistant"  # carries the instrument

    @cached_property  # asked for in each control cycle
    def number(self) -> int:
        """Number from 0, also that of its cycles in the clock."""
        return tuple(ArmRole).index(self)


OTHER_ARMS = tuple(role for role in ArmRole if role is not ArmRole.MASTER)

DetachOption = Annotated[
    bool, typer.Option("--detach", help="Run in the background: return once ready; ronna-sim stop ends it.")
]
FaultsOption = Annotated[Path | None, typer.Option(help="Fault script, one fault per line.")]
ListParametersOption = Annotated[
    bool, typer.Option("--list-parameters", help="List the parameters that --set accepts, and exit.")
]
MarkersOption = Annotated[
    int | None,
    typer.Option(min=1, max=8, help="Spheres on the head: 3 to 8; with mixed fiducials 1 to 3."),
]
RoleOption = Annotated[ArmRole, typer.Option(hidden=True, help="Role of the arm in that theatre.")]
SceneOption = Annotated[str, typer.Option(help="default, mini, bench, or a scene file.")]
SetOption = Annotated[
    list[str] | None,
    typer.Option("--set", metavar="NAME=VALUE", help="Choose an unconfirmed behaviour; repeatable."),
]
TargetsOption = Annotated[int | None, typer.Option(min=1, max=10, help="Trajectories of the plan.")]
WorldOption = Annotated[str | None, typer.Option(hidden=True, help="Address of the parent theatre.")]
