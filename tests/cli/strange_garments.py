"""Garment files as strangers send them: a T-shirt of the built-in woman, spoilt in one way each."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import numpy as np

import pb4u
from pb4u.body.body_model import ShapedBody
from pb4u.garment.library import build_garment
from pb4u.geometry.mesh_file import PolygonMesh
from pb4u.geometry.obj_file import write_obj
from pb4u.geometry.triangle_mesh import face_cross_products


def woman() -> ShapedBody:
    body = pb4u.load_body("woman")
    assert isinstance(body, ShapedBody)
    return body


def shirt(triangles: int = 1200) -> PolygonMesh:
    garment = build_garment("tshirt", woman(), triangles)
    return PolygonMesh(garment.vertices, tuple(garment.faces))


def moved(change: Callable[[np.ndarray], np.ndarray]) -> PolygonMesh:
    mesh = shirt()
    return replace(mesh, vertices=change(mesh.vertices))


def with_faces(*more: list[int]) -> PolygonMesh:
    mesh = shirt()
    return replace(mesh, polygons=(*mesh.polygons, *(np.array(face) for face in more)))


def with_vertices(places: np.ndarray, *faces: list[int]) -> PolygonMesh:
    mesh = shirt()
    count = len(mesh.vertices)
    polygons = (*mesh.polygons, *(np.array(face) % (count + len(places)) for face in faces))
    return replace(mesh, vertices=np.concatenate([mesh.vertices, places]), polygons=polygons)


def halves(apart: float, threads: bool = False) -> PolygonMesh:
    """Front and back by themselves, each moved away by half of `apart` [m], joined by threads or not."""
    mesh = shirt()
    faces, shift = np.stack(mesh.polygons), np.array([0.0, 0.0, 0.5 * apart])
    front = mesh.vertices[faces][:, :, 2].mean(axis=1) > 0.0
    both = np.intersect1d(faces[front], faces[~front])
    parts = []
    for mine in (front, ~front):
        used, local = np.unique(faces[mine], return_inverse=True)
        parts.append((used, local.reshape(-1, 3)))
    (first, a), (second, b) = parts
    return PolygonMesh(
        np.concatenate([mesh.vertices[first] + shift, mesh.vertices[second] - shift]),
        (*a, *(b + len(first))),
        lines=np.column_stack([np.searchsorted(first, both), len(first) + np.searchsorted(second, both)])
        if threads
        else None,
    )


def pocket() -> PolygonMesh:
    """Some faces of the chest once more, a little before it and on the same border."""
    mesh = shirt()
    faces = np.stack(mesh.polygons)
    middle = mesh.vertices[faces].mean(axis=1)
    on = (np.abs(middle[:, 0] - 0.06) < 0.05) & (np.abs(middle[:, 1] - 1.2) < 0.06) & (middle[:, 2] > 0.0)
    inner = np.setdiff1d(faces[on], faces[~on])
    twin = np.arange(len(mesh.vertices))
    twin[inner] = len(mesh.vertices) + np.arange(len(inner))
    lifted = mesh.vertices[inner] + [0.0, 0.0, 0.01]
    return PolygonMesh(np.concatenate([mesh.vertices, lifted]), (*mesh.polygons, *twin[faces[on]]))


def thick() -> PolygonMesh:
    mesh = shirt()
    faces = np.stack(mesh.polygons)
    corners = np.zeros_like(mesh.vertices)
    normals = face_cross_products(mesh.vertices, faces)
    for k in range(3):
        np.add.at(corners, faces[:, k], normals)
    out = corners / np.linalg.norm(corners, axis=1, keepdims=True)
    vertices = np.concatenate([mesh.vertices, mesh.vertices - 0.002 * out])
    return PolygonMesh(vertices, (*faces, *(faces[:, ::-1] + len(mesh.vertices))))


def turned(which: slice) -> PolygonMesh:
    mesh = shirt()
    polygons = list(mesh.polygons)
    polygons[which] = [polygon[::-1] for polygon in polygons[which]]
    return replace(mesh, polygons=tuple(polygons))


def with_body() -> PolygonMesh:
    body, mesh = woman(), shirt()
    faces = (*mesh.polygons, *(body.faces + len(mesh.vertices)))
    return PolygonMesh(np.concatenate([mesh.vertices, body.vertices]), faces)


def graded() -> PolygonMesh:
    """One sleeve of four triangles for each."""
    mesh = shirt()
    faces = np.stack(mesh.polygons)
    fine = mesh.vertices[faces][:, :, 0].mean(axis=1) > 0.0
    edges = np.sort(faces[fine][:, [[0, 1], [1, 2], [2, 0]]].reshape(-1, 2), axis=1)
    names, number = np.unique(edges, axis=0, return_inverse=True)
    mid = number.reshape(-1, 3) + len(mesh.vertices)
    a, b, c = faces[fine].T
    ab, bc, ca = mid.T
    parts = [np.column_stack(each) for each in ((a, ab, ca), (ab, b, bc), (ca, bc, c), (ab, bc, ca))]
    polygons = [*np.concatenate(parts)]
    at = {tuple(edge): k + len(mesh.vertices) for k, edge in enumerate(names.tolist())}
    for face in faces[~fine].tolist():
        loop = []
        for k in range(3):
            loop.append(face[k])
            middle = at.get(tuple(sorted((face[k], face[(k + 1) % 3]))))
            loop += [] if middle is None else [middle]
        polygons.append(np.array(loop))
    return PolygonMesh(np.concatenate([mesh.vertices, mesh.vertices[names].mean(axis=1)]), tuple(polygons))


def partly_unwrapped() -> PolygonMesh:
    mesh = shirt()
    uvs = np.concatenate([mesh.vertices[:, :2], np.zeros((1, 2))])
    bare = np.full(3, len(mesh.vertices))
    return replace(mesh, uvs=uvs, polygon_uvs=(*[bare] * 5, *mesh.polygons[5:]))


def crossing() -> PolygonMesh:
    """A vertex of the front drawn through the back."""
    mesh = shirt()
    vertices = mesh.vertices.copy()
    low = np.flatnonzero((vertices[:, 1] < 0.92) & (np.abs(vertices[:, 0]) < 0.15))
    front = low[vertices[low, 2].argmax()]
    vertices[front, 2] = vertices[low, 2].min() - 0.03
    return replace(mesh, vertices=vertices)


def ring() -> PolygonMesh:
    """A wide tube that nothing holds."""
    angle = np.linspace(0.0, 2.0 * np.pi, 60, endpoint=False)
    rows = [
        np.column_stack([0.23 * np.cos(angle), np.full(60, y), 0.2 * np.sin(angle)]) for y in np.linspace(0.6, 1, 9)
    ]
    row, column = np.divmod(np.arange(60 * 8), 60)
    a, b = row * 60 + column, row * 60 + (column + 1) % 60
    return PolygonMesh(np.concatenate(rows), tuple(np.concatenate([np.column_stack([a, a + 60, b]), np.column_stack([b, a + 60, b + 60])])))  # fmt: skip  # noqa: E501


def zup(places: np.ndarray) -> np.ndarray:
    return places[:, [0, 2, 1]] * [1.0, -1.0, 1.0]


MAKERS: dict[str, Callable[[], PolygonMesh]] = {
    "sound": shirt,
    "in centimetres": lambda: moved(lambda v: 100.0 * v),
    "in inches": lambda: moved(lambda v: 39.37 * v),
    "with Z up": lambda: moved(zup),
    "two metres away": lambda: moved(lambda v: v + [2.0, 0.0, 0.0]),
    "inside out": lambda: turned(slice(None)),
    "some faces turned over": lambda: turned(slice(0, 5)),
    "open seams": lambda: halves(0.0),
    "halves with a gap": lambda: halves(0.0006),
    "sewn by threads": lambda: halves(0.06, threads=True),
    "threads too long": lambda: halves(0.2, threads=True),
    "a pocket sewn on": pocket,
    "two layers": thick,
    "a face twice": lambda: with_faces(shirt().polygons[7].tolist()),
    "a face without area": lambda: with_vertices(shirt().vertices[:1], [0, 1, -1]),
    "vertices of no face": lambda: with_vertices(np.ones((3, 3))),
    "meshed unevenly": graded,
    "partly unwrapped": partly_unwrapped,
    "through itself": crossing,
    "too narrow": lambda: moved(lambda v: v * [0.93, 1.0, 0.9]),
    "held by nothing": ring,
    "too coarse": lambda: shirt(200),
    "a body among it": with_body,
    "a body": lambda: PolygonMesh(woman().vertices, tuple(woman().faces)),
}


def written(folder: Path, case: str) -> Path:
    path = folder / "garment.obj"
    write_obj(path, MAKERS[case]())
    return path
