"""Where a body passes through itself, on bodies of which that is known."""

from __future__ import annotations

import numpy as np
import trimesh

from pb4u.collision.crossings import crossings
from pb4u.measures.metrics import pinched
from pb4u.measures.overlaps import buried, overlapping_faces


def joined(*parts: trimesh.Trimesh) -> tuple[np.ndarray, np.ndarray]:
    whole = trimesh.util.concatenate(parts)
    return np.asarray(whole.vertices, dtype=np.float64), np.asarray(whole.faces, dtype=np.int64)


def test_what_is_inside_another_part_is_buried_and_what_is_beside_it_is_not() -> None:
    one, other = (trimesh.creation.icosphere(subdivisions=3, radius=0.2) for _ in range(2))
    other.apply_translation([0.31, 0.02, 0.01])
    vertices, faces = joined(one, other)
    folds = faces[overlapping_faces(vertices, faces)]
    depths = np.concatenate(
        [
            0.2 - np.linalg.norm(vertices[:642] - [0.31, 0.02, 0.01], axis=1),
            0.2 - np.linalg.norm(vertices[642:], axis=1),
        ]
    )
    assert overlapping_faces(vertices, faces)[(depths > 2e-3)[faces].all(axis=1)].all()
    assert not overlapping_faces(vertices, faces)[(depths < -0.03)[faces].all(axis=1)].any()
    found = buried(np.ones(len(vertices), dtype=bool), vertices, faces, folds)
    # The balls' faces lie a millimetre within them.
    assert found[depths > 2e-3].all()
    assert not found[depths < -2e-3].any()
    assert found.sum() > 20
    assert not buried(np.zeros(len(vertices), dtype=bool), vertices, faces, folds).any()


def test_cloth_in_a_fold_is_pinched_however_far_the_corners_of_the_body_are() -> None:
    box, post = trimesh.creation.box([0.4, 0.4, 0.4]), trimesh.creation.box([0.3, 0.1, 0.1])
    post.apply_translation([0.3, 0.0, 0.01])
    body, body_faces = joined(box, post)
    folds = body_faces[overlapping_faces(body, body_faces)]
    flap = np.array([[-0.005, 0.0, 0.0], [0.005, 0.003, 0.0], [0.005, -0.003, 0.0]])
    # Through the side of the box within the post, 5 cm from its nearest corner, and through that across from it.
    cloth = np.concatenate([flap + [0.2, 0.01, 0.02], flap + [-0.2, 0.01, 0.02]])
    cloth_faces = np.arange(6).reshape(2, 3)
    pairs = crossings(cloth, cloth_faces, body, body_faces)
    within = pinched(pairs, cloth, cloth_faces, body, folds)
    assert set(pairs[within, 0].tolist()) == {0}
    assert set(pairs[~within, 0].tolist()) == {1}
