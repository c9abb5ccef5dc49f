"""Locate the marker spheres in a CT series and print their centres.

    python examples/localize_series.py SERIES_DIR

Coordinates are those of the patient (DICOM LPS) in millimetres; sigma is the predicted error of the centre.
"""

import sys
from pathlib import Path

from procedures.imaging import localize, read_series

if len(sys.argv) != 2:
    sys.exit("usage: localize_series.py SERIES_DIR")

volume = read_series(Path(sys.argv[1]))
for warning in volume.warnings:
    print(f"warning: {warning}", file=sys.stderr)

result = localize(volume)
for number, marker in enumerate(result.markers, start=1):
    x, y, z = marker.centre_mm
    print(f"{number}: L {x:8.3f}  P {y:8.3f}  S {z:8.3f} mm  sigma {marker.sigma_mm:.3f} mm", *marker.flags)
