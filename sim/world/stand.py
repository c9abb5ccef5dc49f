"""The calibration stand on the table: a removable ball, or a divot with three dials.

Staff raise the divot to the tip of a guide and read its offset from the position of the ball's centre, along
the stand's own axes.
"""

from __future__ import annotations

import numpy as np

from sim.errors import StandNotReady
from sim.world.noise import noise
from sim.world.on_stand import OnStand
from sim.world.rigid import rotation_from_vector
from sim.world.true_guide import TrueGuide
from sim.world.world import World


def read_dials(world: World) -> tuple[float, float, float]:
    """The three dials with the divot raised to the guide's tip, mm; raises SIM-015 if that is impossible."""
    stand, mount = world.scene.stand, world.scene.mount
    if (there := world.on_stand()) is not OnStand.DIVOT:
        holds = "nothing" if there is OnStand.NOTHING else f"the {there}"
        raise StandNotReady(f"the divot is not on the stand, which holds {holds}")
    if world.mounted_tool() != mount.tool_number_guide:
        raise StandNotReady("the guide is not mounted", got=f"tool {world.mounted_tool()}")
    zero = np.add(stand.ball_mm, stand.divot_from_ball_mm)
    away = rotation_from_vector(stand.dials_turned_rad).T @ (TrueGuide(world).mandrel()[:3, 3] - zero)
    if np.abs(away).max() > stand.travel_mm:
        raise StandNotReady(
            "the tip is beyond the divot's travel",
            limit=f"{stand.travel_mm:g} mm along each axis",
            got=f"{np.abs(away).max():.1f} mm",
        )
    generator = noise(world.scene.seed, "dials", world.arm().motion_number)
    read = away + generator.normal(0.0, stand.reading_mm, 3)
    x, y, z = (round(value / stand.scale_mm) * stand.scale_mm for value in read.tolist())
    return (x, y, z)
