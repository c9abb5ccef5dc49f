"""Skin in the CT, to register on: in the place of spheres, or with few of them."""

from __future__ import annotations

from dataclasses import replace

from procedures.engine.context import StepContext
from procedures.engine.order import Outcome, Phase, StepSpec
from procedures.imaging.ct_surface import CtSurface, find_bone, find_skin
from procedures.planning.faced_head import fit_cranium_and_face
from procedures.registration.surface.errors import HALF_A_HEAD
from procedures.registration.surface.regions import CHEEKS_MM, HeadAxes
from procedures.registration.surface.surface import Surface
from procedures.relocalization.triangulation import SPHERE_DIAMETER_MM
from procedures.steps.clinical.ct_import import ImportedCt, volume_of
from procedures.steps.clinical.fiducial_localization import ExcludedSkin, LocalizedFiducials, SkinInCt
from procedures.steps.conditions import needs_guide_unmounted
from procedures.workcell.line_look import require_scanner

LEAST_TOLD = 0.01  # of the boundary, for a part that is not used to be told of
# Depth of the skin below the vertex, scaled to a usual head.
# Safety against a CT without nose and ears, which alone show a turn. Source: usual proportions, their base.
LEAST_DEPTH_MM = CHEEKS_MM


def run(context: StepContext) -> Outcome[SkinInCt]:
    """Find the skin.

    Raises CT-028 without a head, SRF-037 for half a head, and SRF-030, SRF-031, SRF-034 for a theatre that
    cannot scan it.
    """
    workcell = context.workcell
    require_scanner(workcell.stereo, workcell.patient_frame, workcell.calibrations)
    context.result(ImportedCt)
    spheres = context.result(LocalizedFiducials) if LocalizedFiducials in context.reads else None
    skin = skin_of(context)
    require_face(skin)
    cranium, face = fit_cranium_and_face(skin)
    return Outcome(
        SkinInCt(
            series_instance_uid=volume_of(context).series_instance_uid,
            diameter_mm=SPHERE_DIAMETER_MM,
            markers=() if spheres is None else spheres.markers,
            doubtful=() if spheres is None else spheres.doubtful,
            deformation=None if spheres is None else spheres.deformation,
            localizer=context.clinical.methods.localizer,
            samples=len(skin.points_mm),
            cranium=cranium,
            face=face,
            excluded=tuple(
                ExcludedSkin(reason=str(one.reason), share=one.share, middle_mm=one.middle_ct_mm)
                for one in skin.excluded
            ),
        ),
        summary=f"{len(skin.points_mm)} places on the skin"
        + "".join(
            f"; not used: {one.share:.0%}, {one.reason}" for one in skin.excluded if one.share >= LEAST_TOLD
        ),
    )


def require_face(skin: Surface) -> None:
    """Raise SRF-037 if the CT ends above the base of the nose."""
    depth_mm = float(HeadAxes.of(skin).depth_mm(skin.points_mm).max())
    if depth_mm < LEAST_DEPTH_MM:
        raise HALF_A_HEAD(
            "the CT shows the upper part of the head only",
            limit=f"{LEAST_DEPTH_MM:g} mm below the vertex of a usual head",
            got=f"{depth_mm:.0f} mm",
        )


def skin_of(context: StepContext) -> CtSurface:
    """Return the skin of the imported CT, found once a session. Raises CT-028 and as `volume_of`."""
    memory = context.setting.memory
    skin = memory.find(CtSurface)
    if skin is None:
        skin = find_skin(volume_of(context))
        memory.keep(skin)
    return skin


def bone_of(context: StepContext) -> CtSurface:
    """Return the skull of the imported CT. Raises CT-028 and as `volume_of`."""
    return find_bone(volume_of(context))


STEP = StepSpec(
    SkinInCt,
    "Find the skin in the CT",
    Phase.PREOPERATIVE,
    run,
    reads=(ImportedCt,),
    preconditions=needs_guide_unmounted,
)
WITH_SPHERES = replace(STEP, reads=(ImportedCt, LocalizedFiducials))
