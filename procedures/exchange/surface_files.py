"""Scan of a surface as PLY (points for any viewer) and as VTP (VTK's poly data, for ParaView and 3D Slicer).

Written with the standard library: of the packages that write them, meshio has no VTP, and VTK has a hundred
megabytes. Coordinates are mm in the named frame, which both files say.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any
from xml.etree import ElementTree

import numpy as np
from numpy.typing import NDArray

from procedures.registration.surface.scan import SurfaceScan
from ronna_hw.frames import Frame

# Rows and columns of the upper triangle, in VTK's order of a symmetric tensor
TENSOR_ROWS, TENSOR_COLUMNS = (0, 1, 2, 0, 1, 0), (0, 1, 2, 1, 2, 2)
TENSOR_NAMES = ("xx", "yy", "zz", "xy", "yz", "xz")
NUMBER = "%.9g"  # a nanometre at one metre
PLY_TYPES = {"<f8": "double", "<f4": "float", "<i4": "int"}


def encode_scan_ply(scan: SurfaceScan, frame: Frame = Frame.ROBOT) -> bytes:
    """Encode the points with view, covariance, look and line as properties of each vertex."""
    tensor = _tensor(scan)
    columns = {
        **{name: scan.points_mm[:, axis].astype("<f8") for axis, name in enumerate("xyz")},
        **{f"view_{name}": scan.view_mm[:, axis].astype("<f8") for axis, name in enumerate("xyz")},
        **{f"covariance_{name}": tensor[:, place].astype("<f8") for place, name in enumerate(TENSOR_NAMES)},
        "look": scan.look.astype("<i4"),
        "line": scan.line.astype("<i4"),
    }
    return encode_ply(
        columns,
        f"points of a scanned surface, mm, in the frame {_describe(frame)}; covariances in mm2, of the "
        "measurement of each point alone",
    )


def encode_ply(columns: Mapping[str, NDArray[Any]], comment: str) -> bytes:
    """Encode vertices with these properties as a binary PLY file."""
    rows = np.zeros(
        len(next(iter(columns.values()))), dtype=[(name, one.dtype) for name, one in columns.items()]
    )
    for name, one in columns.items():
        rows[name] = one
    head = [
        "ply",
        "format binary_little_endian 1.0",
        f"comment {comment}",
        f"element vertex {len(rows)}",
        *(f"property {PLY_TYPES[one.dtype.str]} {name}" for name, one in columns.items()),
        "end_header",
        "",
    ]
    return "\n".join(head).encode("ascii") + rows.tobytes()


def encode_scan_vtp(scan: SurfaceScan, frame: Frame = Frame.ROBOT) -> bytes:
    """Encode the points as one vertex cell each, with the same values as point data, in text."""
    count = str(len(scan))
    root = ElementTree.Element("VTKFile", type="PolyData", version="1.0", byte_order="LittleEndian")
    data = ElementTree.SubElement(root, "PolyData")
    field = ElementTree.SubElement(data, "FieldData")
    codes = " ".join(str(code) for code in f"{_describe(frame)}, mm".encode("ascii"))
    name = ElementTree.SubElement(
        field, "DataArray", type="String", Name="frame", NumberOfTuples="1", format="ascii"
    )
    name.text = f"{codes} 0"
    none = {f"NumberOf{each}": "0" for each in ("Lines", "Strips", "Polys")}
    piece = ElementTree.SubElement(data, "Piece", none | {"NumberOfPoints": count, "NumberOfVerts": count})
    values = ElementTree.SubElement(piece, "PointData")
    _add(values, "view_mm", scan.view_mm)
    _add(values, "covariance_mm2", _tensor(scan))
    _add(values, "look", scan.look)
    _add(values, "line", scan.line)
    _add(ElementTree.SubElement(piece, "Points"), "points_mm", scan.points_mm)
    cells = ElementTree.SubElement(piece, "Verts")
    _add(cells, "connectivity", np.arange(len(scan)))
    _add(cells, "offsets", np.arange(len(scan)) + 1)
    return bytes(ElementTree.tostring(root, encoding="utf-8", xml_declaration=True))


def _describe(frame: Frame) -> str:
    return f"{frame} (LPS)" if frame is Frame.CT else str(frame)


def _tensor(scan: SurfaceScan) -> NDArray[np.float64]:
    return scan.covariance_mm2[:, TENSOR_ROWS, TENSOR_COLUMNS]


def _add(parent: ElementTree.Element, name: str, values: NDArray[np.float64] | NDArray[np.int64]) -> None:
    is_whole = np.issubdtype(values.dtype, np.integer)
    width = values.shape[1] if values.ndim == 2 else 1
    element = ElementTree.SubElement(
        parent,
        "DataArray",
        type="Int64" if is_whole else "Float64",
        Name=name,
        NumberOfComponents=str(width),
        format="ascii",
    )
    form = " ".join(["%d" if is_whole else NUMBER] * width)
    rows = values.reshape(len(values), width).tolist()
    element.text = "\n".join(form % tuple(row) for row in rows)
