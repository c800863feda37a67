import json
import warnings
from dataclasses import replace

import igl
import numpy as np
import pytest
from cloth_shapes import quad_tube, triangle_tube, tube_garment, with_open_seam

from pb4u.body.library import load_body
from pb4u.errors import InputError, InputWarning
from pb4u.garment.diagnosis import diagnose, require_worn
from pb4u.garment.findings import Severity
from pb4u.garment.fit import RestBody
from pb4u.garment.library import build_garment
from pb4u.garment.pins import resolve_pins
from pb4u.garment.support import find_support
from pb4u.geometry.mesh_file import PolygonMesh


@pytest.fixture(scope="module")
def woman():
    return load_body("woman")


FILE = "GARMENT.obj"


def found_support(garment, body):
    return find_support(garment.vertices, garment.faces, RestBody.of(body))


def finding(diagnosis, code):
    assert code in diagnosis.codes
    return next(f for f in diagnosis.findings if f.code == code)


def test_a_sound_garment_has_nothing_to_mend(woman):
    shirt = build_garment("tshirt", woman, 1200)
    diagnosis = diagnose(PolygonMesh(shirt.vertices, tuple(shirt.faces)), woman)
    assert diagnosis.codes == ()
    assert not diagnosis.is_refused
    assert diagnosis.measures["boundary_loops"] == 4
    assert diagnosis.measures["penetration_percent"] == 0.0


def test_what_nothing_holds_up_is_a_hint_and_no_damage(woman):
    garment = tube_garment(low=0.6, high=1.0, radius=0.22)
    diagnosis = diagnose(garment, woman)
    hint = finding(diagnosis, "unsupported")
    assert diagnosis.codes == ("unsupported",)
    assert hint.severity is Severity.NOTE
    assert not hint.mendable
    assert not diagnosis.is_refused
    assert hint.sentence == ("Nothing holds the garment up: none of it lies on the shoulders; it would slide down.")
    assert "`--pins waist`" in hint.fix
    with pytest.warns(InputWarning, match=r"^tube: .*`--pins waist`"):
        require_worn(garment, woman, FILE, found_support(garment, woman))
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        require_worn(garment, woman, FILE, None)
    assert diagnose(garment.with_pins(resolve_pins("waist", garment)), woman).codes == ()


@pytest.mark.slow
def test_support_is_looked_for_where_the_garment_belongs(woman):
    shirt = build_garment("tshirt", woman, 1200)
    low = PolygonMesh(100.0 * (shirt.vertices - [0.0, woman.lift, 0.0]), tuple(shirt.faces))
    assert "units" in diagnose(low, woman).codes
    assert "unsupported" not in diagnose(low, woman).codes


def test_every_fault_of_the_mesh_is_named_with_its_place():
    mesh = triangle_tube()
    faces = np.stack(mesh.polygons)
    faces[11] = faces[11][::-1]
    extra = (np.array([500, 501, 0]), faces[7], np.array([9, 9, 10]))
    diagnosis = diagnose(PolygonMesh(np.concatenate([mesh.vertices, [[0, 2, 0.0]]]), (*faces, *extra)))
    assert diagnosis.is_refused
    assert diagnosis.findings[0].severity is Severity.REFUSED
    shared = finding(diagnosis, "non-manifold")
    assert "500-501" in shared.sentence
    assert shared.where == (1600,)
    assert not shared.mendable
    assert finding(diagnosis, "duplicate").where == (1601,)
    assert finding(diagnosis, "degenerate").where == (1602,)
    assert finding(diagnosis, "isolated").where == (len(mesh.vertices),)
    assert 11 in finding(diagnosis, "orientation").where
    assert finding(diagnosis, "duplicate").vertices == tuple(sorted(faces[7].tolist()))
    assert finding(diagnosis, "isolated").vertices == (len(mesh.vertices),)
    assert set(finding(diagnosis, "non-manifold").vertices) == {500, 501}
    written = json.loads(json.dumps(diagnosis.to_json()))
    assert written["refused"]
    assert {f["code"] for f in written["findings"]} == set(diagnosis.codes)


def test_pieces():
    mesh = quad_tube()
    two = PolygonMesh(
        np.concatenate([mesh.vertices, mesh.vertices * [2.0, 1.0, 2.0]]),
        mesh.polygons + tuple(p + len(mesh.vertices) for p in mesh.polygons),
    )
    diagnosis = diagnose(two)
    assert "2 pieces" in finding(diagnosis, "pieces").sentence


def test_a_solidified_shell_is_double(woman):
    mesh = triangle_tube()
    shell = mesh.vertices * [0.985, 1.0, 0.985]
    inner = tuple(p[::-1] + len(mesh.vertices) for p in mesh.polygons)
    diagnosis = diagnose(PolygonMesh(np.concatenate([mesh.vertices, shell]), mesh.polygons + inner))
    assert "double-layer" in diagnosis.codes
    assert "double-layer" not in diagnose(mesh).codes


def test_graded_edge_lengths_propose_a_triangle_count():
    mesh = triangle_tube()
    stretched = mesh.vertices.copy()
    stretched[:, 1] = 0.5 + 2.0 * (stretched[:, 1] - 0.5) ** 2
    diagnosis = diagnose(replace(mesh, vertices=stretched))
    assert "--triangles 1600" in finding(diagnosis, "graded").fix
    assert "graded" not in diagnose(mesh).codes


def test_first_frame_penetration_is_measured(woman):
    garment = tube_garment(low=0.95, high=1.05, radius=0.17)
    diagnosis = diagnose(garment, woman)
    said = finding(diagnosis, "penetration")
    assert said.mendable
    assert said.severity is Severity.WARNING
    assert 1.0 < diagnosis.measures["penetration_percent"] < 60.0
    assert diagnosis.measures["penetration_depth_max"] > 0.002
    with pytest.warns(InputWarning, match="start inside the body, the deepest"):
        require_worn(garment, woman, FILE, None)


def test_a_garment_wholly_inside_is_refused(woman):
    garment = tube_garment(low=1.0, high=1.2, radius=0.04)
    garment = replace(garment, vertices=garment.vertices + np.array([0.0, 0.0, 0.03]))
    diagnosis = diagnose(garment, woman)
    assert finding(diagnosis, "inside").severity is Severity.REFUSED
    assert "inside-out" not in diagnosis.codes
    with pytest.raises(InputError, match="wholly inside the body"):
        require_worn(garment, woman, FILE, found_support(garment, woman))


def test_the_cure_is_for_the_body_that_wears_the_garment():
    body = load_body("woman", {"weight": 0.9, "height": 0.5})
    low = tube_garment(low=0.95, high=1.05, radius=0.17)
    with pytest.warns(InputWarning, match=r"--body-shape weight=0\.9 --fix OUT\.obj"):
        require_worn(low, body, "mine.obj", None)
    assert "--body-shape weight=0.9 --fix" in finding(diagnose(low, body), "penetration").fix


def test_a_garment_far_from_the_body_is_refused(woman):
    garment = tube_garment()
    far = replace(garment, vertices=garment.vertices + np.array([3.0, 0.0, 0.0]))
    assert finding(diagnose(far, woman), "far").severity is Severity.REFUSED
    assert "unsupported" not in diagnose(far, woman).codes
    with pytest.raises(InputError, match=r"far from the body.*2.[0-9]+ m away"):
        require_worn(far, woman, FILE, found_support(far, woman))


def test_z_up_is_told_and_a_garment_that_lies_on_the_floor_is_refused(woman):
    garment = tube_garment(low=0.2, high=1.0, radius=0.22)
    lying = replace(garment, vertices=garment.vertices[:, [0, 2, 1]] * [1.0, -1.0, 1.0])
    diagnosis = diagnose(lying, woman)
    assert "Z up" in finding(diagnosis, "axes").sentence
    assert finding(diagnosis, "axes").severity is Severity.WARNING
    assert finding(diagnosis, "misplaced").severity is Severity.REFUSED
    with pytest.raises(InputError, match=r"not on the body.*check GARMENT.obj --fix"):
        require_worn(lying, woman, FILE, found_support(lying, woman))


def test_other_units_are_named(woman):
    mesh = triangle_tube(low=0.6, high=1.0, radius=0.22)
    diagnosis = diagnose(replace(mesh, vertices=100.0 * mesh.vertices), woman)
    assert "centimetres" in finding(diagnosis, "units").sentence
    assert "scale it by 0.01" in finding(diagnosis, "units").fix
    assert "units" in diagnose(replace(mesh, vertices=1000.0 * mesh.vertices)).codes


def test_penetration_is_not_reported_for_a_body_with_holes(woman):
    open_body = replace(woman, faces=woman.faces[200:])
    garment = tube_garment(low=0.95, high=1.05, radius=0.17)
    diagnosis = diagnose(garment, open_body)
    assert "open-body" in diagnosis.codes
    assert "penetration" not in diagnosis.codes
    assert diagnosis.measures["penetration_percent"] is None
    assert diagnosis.measures["penetration_depth_max"] is None
    with warnings.catch_warnings():
        # Who loads an open body is warned of it: a garment does not say so again.
        warnings.simplefilter("error")
        require_worn(garment, open_body, FILE, None)


def test_a_garment_inside_out_is_told(woman):
    mesh = triangle_tube(low=0.6, high=1.0, radius=0.22)
    turned = replace(mesh, polygons=tuple(p[::-1] for p in mesh.polygons))
    assert diagnose(turned, woman).codes == ("inside-out", "unsupported")


def dented(depth: float) -> PolygonMesh:
    """A tube with its front drawn through its back by some of its width."""
    mesh = triangle_tube(low=0.6, high=1.0, radius=0.3)
    vertices = mesh.vertices.copy()
    front = np.exp(-((vertices[:, 0] / 0.1) ** 2) - ((vertices[:, 1] - 0.8) / 0.08) ** 2) * (vertices[:, 2] > 0)
    vertices[:, 2] -= depth * front
    return PolygonMesh(vertices, mesh.polygons)


def test_a_garment_that_crosses_itself_is_told_where_and_untangled_by_simulation():
    diagnosis = diagnose(dented(0.62))
    told = finding(diagnosis, "self-crossing")
    assert told.severity is Severity.WARNING
    assert told.sentence.startswith("The garment crosses itself in ")
    assert "pairs of triangles around (" in told.sentence
    assert "the simulation untangles it at its start, by at most" in told.fix
    assert diagnosis.measures["self_intersections"] > 10
    centres = dented(0.62).vertices[np.stack(dented(0.62).polygons)[list(told.where)]].mean(axis=1)
    assert np.abs(centres[:, 1] - 0.8).max() < 0.1
    assert "self-crossing" not in diagnose(dented(0.5)).codes
    assert diagnose(dented(0.5)).measures["self_intersections"] == 0.0


def test_a_garment_that_cannot_be_untangled_is_refused():
    mesh = triangle_tube(low=0.6, high=1.0, radius=0.22)
    vertices = mesh.vertices.copy()
    vertices[:, 0] *= np.where(vertices[:, 1] > 0.8, -1.0, 1.0)
    told = finding(diagnose(PolygonMesh(vertices, mesh.polygons)), "self-crossing")
    assert told.severity is Severity.REFUSED
    assert "`--self-contact off`" in told.fix


def test_an_open_seam_crosses_nothing():
    assert "self-crossing" not in diagnose(with_open_seam(triangle_tube(low=0.6, high=1.0, radius=0.22))).codes


def test_an_uneven_and_coarse_garment_is_told_one_number_of_triangles(woman):
    garment = build_garment("longsleeve", woman, 300)
    vertices, faces = garment.vertices, garment.faces
    fine = faces[:40]
    for _ in range(2):  # each of forty faces becomes nine
        middle = len(vertices) + np.arange(len(fine))
        vertices = np.concatenate([vertices, vertices[fine].mean(axis=1)])
        fine = np.concatenate([np.column_stack([fine[:, k], fine[:, (k + 1) % 3], middle]) for k in range(3)])
    diagnosis = diagnose(PolygonMesh(vertices, tuple(np.concatenate([faces[40:], fine]))), woman)
    coarse = next(f for f in diagnosis.findings if f.code in ("coarse", "too-coarse"))
    assert finding(diagnosis, "graded").fix == coarse.fix


@pytest.mark.slow
def test_a_garment_made_for_the_other_body_names_it(woman):
    man = load_body("man")
    garment = build_garment("longsleeve", man, 1500)
    skin = igl.point_mesh_squared_distance(garment.vertices, man.vertices, man.faces)[2]
    # Close to its own body, as clothes without ease are.
    own = PolygonMesh(skin + 0.3 * (garment.vertices - skin), tuple(garment.faces))
    found = finding(diagnose(own, woman), "other-body")
    assert found.fix == "give --body man"
    assert 'fits the body "man" better' in found.sentence
    assert "other-body" not in diagnose(own, man).codes
