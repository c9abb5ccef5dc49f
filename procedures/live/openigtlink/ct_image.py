"""`python -m procedures.live.openigtlink.ct_image SERIES VERSION`: write a CT as one IMAGE message.

A process of the OpenIGTLink server. It is nicer than that: nobody's pose waits for a CT.
"""

from __future__ import annotations

import os
import sys
from pathlib import Path

from ronna_hw.host.process import limit_to_one_thread

NICER = 10


def main() -> None:
    """Write the message to standard output; an error goes to standard error, with its exit code."""
    os.nice(NICER)
    limit_to_one_thread()
    from ronna_hw.errors import RonnaError

    series, version = Path(sys.argv[1]), int(sys.argv[2])
    try:
        message = encode_ct(series, version)
    except (RonnaError, OSError) as error:
        sys.stderr.write(f"{error}\n")
        sys.exit(1)
    sys.stdout.buffer.write(message)


def encode_ct(series: Path, version: int) -> bytes:
    """Read a CT series and encode it in HU, in RAS. Raises its CT errors, and OSError."""
    import numpy as np

    from procedures.imaging.series import read_series
    from procedures.live.openigtlink.names import CT_IMAGE, RAS_FROM_LPS
    from ronna_hw.wire.openigtlink import encode_message
    from ronna_hw.wire.openigtlink_contents import CoordinateSystem, ScalarType, encode_image

    volume = read_series(series)
    geometry = volume.geometry
    placement = np.eye(4)
    placement[:3, :3] = (geometry.axes * geometry.spacing_mm)[:, ::-1]  # for column, row, slice
    placement[:3, 3] = geometry.origin_mm
    slices, rows, columns = geometry.shape
    voxels = volume.voxels.astype("<i2", copy=False).tobytes()
    placed = RAS_FROM_LPS @ placement
    size = (columns, rows, slices)
    content = encode_image(size, voxels, ScalarType.INT16, placed, CoordinateSystem.RAS)
    return encode_message("IMAGE", CT_IMAGE, content, version=version)


if __name__ == "__main__":
    main()
