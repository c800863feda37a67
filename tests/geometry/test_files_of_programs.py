"""Two quads as programs write them: comments, colours, groups, byte orders and line ends as each has them."""

from __future__ import annotations

import struct
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest

from pb4u.errors import InputError
from pb4u.garment.garment_file import read_source

PLACES = np.array([[0, 0, 0], [1, 0, 0], [1, 1, 0], [0, 1, 0], [2, 0, 0], [2, 1, 0]], dtype=float)
QUADS = ([0, 1, 2, 3], [1, 4, 5, 2])


def v(after: str = "", before: str = "") -> str:
    return "".join(f"{before}v {x:g} {y:g} {z:g}{after}\n" for x, y, z in PLACES)


VT = "vt 0 0\nvt 1 0\nvt 1 1\nvt 0 1\nvt 2 0\nvt 2 1\n"
PLAIN = v() + "f 1 2 3 4\nf 2 5 6 3\n"
CORNERS = "f 1/1/1 2/2/1 3/3/1 4/4/1\nf 2/2/1 5/5/1 6/6/1 3/3/1\n"
OBJ = {
    "Blender": f"# Blender 4.2.0\no Shirt\n{v(' 0.5 0.5 0.5')}vn 0 0 1\n{VT}s 0\nusemtl Cloth.001\n{CORNERS}",
    "Maya": f"g default\n{v()}{VT}vn 0 0 1\ns off\ng pCube1\nusemtl initialShadingGroup\n{CORNERS}",
    "ZBrush": f"#Vertex Count 6\ng default\n{v()}#MRGB ff9a9a9aff9a9a9a\nf 1 2 3 4\nf 2 5 6 3\n#\n# end",
    "MeshLab": v(" 0.75 0.75 0.75", "vn 0 0 6.28\n") + "\nf 1//1 2//2 3//3 4//4\nf 2//2 5//5 6//6 3//3\n",
    "CLO": f"g Pattern 2D_1\nusemtl FABRIC 1\n{v()}{VT.replace(chr(10), ' 0' + chr(10))}f 1/1/ 2/2/ 3/3/ 4/4/ \n"
    "g Pattern 2D_2\nf 2/2/ 5/5/ 6/6/ 3/3/\n",
    "line ends of an old Macintosh": PLAIN.replace("\n", "\r"),
    "line ends of Windows and a byte order mark": "\ufeff" + PLAIN.replace("\n", "\r\n"),
    "continued lines": v() + "f 1 2 \\\n 3 4\nf 2 5 6 3",
    "indices that count back": v() + "f -6 -5 -4 -3\nf -5 -2 -1 -4\n",
    "a fourth coordinate": v(" 1.0") + "f 1 2 3 4\nf 2 5 6 3\n",
}
XYZ = "property float x\nproperty float y\nproperty float z\n"
LIST = "property list uchar int vertex_indices\n"


def ply(form: str, vertex: str, face: str, row: Callable[[list], bytes], corners: Callable[[list], bytes]) -> bytes:
    head = f"ply\nformat {form} 1.0\ncomment made\nelement vertex 6\n{vertex}element face 2\n{face}end_header\n"
    return head.encode() + b"".join(map(row, PLACES.tolist())) + b"".join(map(corners, QUADS))


def text(row: list) -> bytes:
    return (" ".join(f"{number:g}" for number in row) + " \n").encode()


PLY = {
    "MeshLab": ply("binary_little_endian", XYZ + "".join(f"property uchar {c}\n" for c in ("red", "green", "blue",
                   "alpha")), LIST, lambda p: struct.pack("<3f4B", *p, 1, 2, 3, 255),
                   lambda f: struct.pack("<B4i", 4, *f)),
    "Blender": ply("binary_little_endian", XYZ + "property float s\nproperty float t\n", LIST.replace("int", "uint"),
                   lambda p: struct.pack("<5f", *p, 0.1, 0.2), lambda f: struct.pack("<B4I", 4, *f)),
    "Open3D": ply("binary_little_endian", XYZ.replace("float", "double"), LIST.replace("int", "uint"),
                  lambda p: struct.pack("<3d", *p), lambda f: struct.pack("<B4I", 4, *f)),
    "Artec": ply("binary_big_endian", XYZ, LIST.replace("indices", "index") + "property list uint8 float32 texcoord\n",
                 lambda p: struct.pack(">3f", *p), lambda f: struct.pack(">B4iB8f", 4, *f, 8, *range(8))),
    "CloudCompare": ply("ascii", XYZ, LIST, text, lambda f: text([4, *f])).replace(b"\n", b"\r\n"),
}  # fmt: skip
COUNTED = "6 2 0\n" + "".join(f"{x:g} {y:g} {z:g}\n" for x, y, z in PLACES) + "4 0 1 2 3\n4 1 4 5 2\n"
OFF = {"plain": "OFF\n" + COUNTED, "comment": "OFF\n# made\n\n" + COUNTED, "on one line": "OFF " + COUNTED,
       "coloured": "OFF\n" + COUNTED.replace("4 0 1 2 3", "4 0 1 2 3 255 0 0")}  # fmt: skip
FILES = [(".obj", name, content.encode()) for name, content in OBJ.items()]
FILES += [(".ply", name, content) for name, content in PLY.items()]
FILES += [(".off", name, content.encode()) for name, content in OFF.items()]


@pytest.mark.parametrize(("suffix", "program", "content"), FILES, ids=[f"{s} {n}" for s, n, _ in FILES])
def test_a_mesh_is_read_as_programs_write_it(tmp_path: Path, suffix: str, program: str, content: bytes) -> None:
    (tmp_path / f"mesh{suffix}").write_bytes(content)
    mesh = read_source(tmp_path / f"mesh{suffix}")
    np.testing.assert_allclose(mesh.vertices, PLACES)
    assert [list(polygon) for polygon in mesh.polygons] == list(QUADS)


@pytest.mark.parametrize("kind", ["binary that begins as text does", "two solids"])
def test_an_stl_is_read_as_programs_write_it(tmp_path: Path, kind: str) -> None:
    triangles = PLACES[[[0, 1, 2], [0, 2, 3], [1, 4, 5], [1, 5, 2]]]
    if kind == "two solids":
        content = b""
        for name, part in (("a", triangles[:2]), ("b", triangles[2:])):
            facets = "".join(
                "facet normal 0 0 1\nouter loop\n" + "".join("vertex {:g} {:g} {:g}\n".format(*p) for p in t) +
                "endloop\nendfacet\n" for t in part)  # fmt: skip
            content += f"solid {name}\n{facets}endsolid {name}\n".encode()
    else:
        content = b"solid made".ljust(80) + struct.pack("<I", 4)
        content += b"".join(struct.pack("<12fH", 0, 0, 1, *t.ravel(), 0) for t in triangles)
    (tmp_path / "mesh.stl").write_bytes(content)
    mesh = read_source(tmp_path / "mesh.stl")
    assert (len(mesh.vertices), len(mesh.polygons)) == (6, 4)


@pytest.mark.parametrize(
    ("name", "way_out"),
    [("a.fbx", "import it in Blender"), ("a.zprj", "export OBJ there"), ("a.usd", "OBJ of a garment"),
     ("a.abc", "OBJ of a garment"), ("a.dxf", "SVG")],
)  # fmt: skip
def test_a_file_of_another_program_is_refused_with_a_way_out(tmp_path: Path, name: str, way_out: str) -> None:
    with pytest.raises(InputError, match=f"{name} is not a kind of garment file.*{way_out}"):
        read_source(tmp_path / name)
