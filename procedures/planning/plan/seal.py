"""The seal of a plan: who saved it, on which voxels, and that it has not been altered since."""

from __future__ import annotations

import hashlib
from typing import TYPE_CHECKING

from procedures.planning.errors import AlteredPlan, OtherVoxels
from procedures.planning.plan.model import Plan, Seal
from ronna_hw.records import canonical_json

if TYPE_CHECKING:
    from procedures.imaging.volume import Volume

UNSEALED = "0" * 64  # stands in for a plan's digest while it is computed


def ct_digest(volume: Volume) -> str:
    """SHA-256 of a CT's voxels and geometry."""
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


def sealed(plan: Plan, author: str, volume: Volume) -> Plan:
    """The plan with a seal. Raises pydantic's ValidationError for an author without a name."""
    open_seal = Seal(author=author, ct_sha256=ct_digest(volume), plan_sha256=UNSEALED)
    unsealed = plan.model_copy(update={"seal": open_seal})
    return unsealed.model_copy(
        update={"seal": open_seal.model_copy(update={"plan_sha256": _plan_digest(unsealed)})}
    )


def require_unaltered(plan: Plan, name: str) -> None:
    """Raises PLAN-023 if a plan does not match its seal."""
    if plan.seal is not None and plan.seal.plan_sha256 != _plan_digest(plan):
        raise AlteredPlan(f"{name} was altered after {plan.seal.author} saved it")


def other_voxels(plan: Plan, volume: Volume) -> OtherVoxels | None:
    """The finding that a sealed plan was made on other voxels, or None."""
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


def _plan_digest(plan: Plan) -> str:
    assert plan.seal is not None
    as_signed = plan.model_copy(update={"seal": plan.seal.model_copy(update={"plan_sha256": UNSEALED})})
    return hashlib.sha256(
        canonical_json(as_signed.model_dump(mode="json", by_alias=True, exclude_none=True))
    ).hexdigest()
