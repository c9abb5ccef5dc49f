"""Checks whether the spheres of CT and robot agree, each a value beside its limit."""

from __future__ import annotations

from dataclasses import dataclass

from procedures.registration.arm_hypotheses import LARGEST_SHARE
from procedures.registration.error_theory import FreGate
from procedures.registration.look_checks import CheckedLooks
from procedures.registration.moved_sphere import MOST_PROBABLE
from ronna_hw.text import format_distinct


@dataclass(frozen=True)
class SphereCheck:
    """One check, as a refusal states it: `quantity` and its `limit` are in `unit`."""

    failure: str
    quantity: str
    value: float
    limit: float
    unit: str
    decimals: int  # in a refusal
    passed: bool

    def show(self, decimals: int) -> tuple[str, str]:
        """Return value and limit in words that differ, with at least this many decimals."""
        value, limit = format_distinct(self.value, self.limit, decimals)
        return f"{value}{self.unit}", f"{limit}{self.unit}"


def check_residual(gate: FreGate) -> SphereCheck:
    """Check the residual of a fit."""
    return SphereCheck(
        "the fit disagrees with its own error budget",
        "residual",
        gate.fre_mm,
        gate.limit_mm,
        " mm",
        3,
        gate.passed,
    )


def check_looks(checked: CheckedLooks) -> tuple[SphereCheck, ...]:
    """List the checks of an arm learned from its looks, the most telling first."""
    probability, share = float(checked.moved.probability[0]), float(checked.shares[0])
    chi_square = float(checked.chi_squares[0])
    return (
        SphereCheck(
            "a sphere that has moved explains the looks better than errors of the arm",
            "probability that a sphere has moved",
            100.0 * probability,
            100.0 * MOST_PROBABLE,
            "%",
            0,
            not bool(checked.moved.is_probable[0]),
        ),
        SphereCheck(
            "the looks show larger errors of the arm than it is accepted with",
            "errors of the arm, of their stated size",
            100.0 * share,
            100.0 * LARGEST_SHARE,
            "%",
            0,
            share <= LARGEST_SHARE,
        ),
        SphereCheck(
            "the looks disagree with the error budget of every arm that is accepted",
            "chi-square of the looks",
            chi_square,
            checked.limit,
            "",
            1,
            chi_square <= checked.limit,
        ),
    )
