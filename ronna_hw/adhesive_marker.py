"""Adhesive marker: a soft ring glued to the skin before a CT, as navigation systems use them.

It shows in the CT only. Neither the tracker nor the stereo head sees it, and it moves with the skin: a case
of this project needs spheres.
"""

from __future__ import annotations

# Usual size of a single-use ring, outer and inner diameter 15 and 5 mm (unconfirmed for the thesis' own)
OUTER_RADIUS_MM = 7.5
INNER_RADIUS_MM = 2.5
THICKNESS_MM = 3.5
