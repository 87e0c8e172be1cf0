"""A scene as convex solids."""

from __future__ import annotations

import numpy as np

from beamseg_batch.geometry import matrix_from_rpy
from beamseg_batch.simulation.solids import (
    BALL,
    BOX,
    CLUTTER,
    CYLINDER,
    distances_to_solids,
    solids_of,
)
from beamseg_batch.world.scene import Box, Rectangle, Scene, Sphere
from tests.simulation.conftest import make_member
from tests.simulation.fields import to_member


def test_solids_of__kinds_and_owners():
    scene = Scene(
        "",
        (make_member("round"), make_member("i")),
        boxes=(Box(np.zeros(3), np.ones(3)),),
        spheres=(Sphere(np.zeros(3), 1.0),),
        rectangles=(Rectangle(np.zeros(3), np.ones(2)),),
    )
    solids = solids_of(scene)
    assert solids.kinds.tolist() == [CYLINDER, BOX, BOX, BOX, BOX, BALL, BOX]
    assert solids.owners.tolist() == [0, 1, 1, 1, CLUTTER, CLUTTER, CLUTTER]
    np.testing.assert_allclose(solids.halves[-1], [0.5, 0.5, 0.0])


def test_solids_of__empty_scene():
    solids = solids_of(Scene(""))
    assert len(solids) == 0
    assert distances_to_solids(solids, np.zeros((4, 3))).shape == (4, 0)


def test_distances_to_solids__of_every_shape(member):
    """The union of a member's solids is as far away as the shape it is made of."""
    points = np.random.default_rng(1).uniform((-1.2, -1.2, 0), (1.2, 1.2, 2.4), (400, 3))
    distances = distances_to_solids(solids_of(Scene("", (member,))), points).min(axis=1)
    expected = np.maximum(to_member(points, member), 0.0)
    np.testing.assert_allclose(distances, expected, atol=2e-4 if member.bow else 1e-9)
    assert (expected > 0.2).any()


def test_distances_to_solids__of_clutter():
    turn = matrix_from_rpy(0.4, 0.1, -0.8)
    box = Box(np.array([1.0, 0.0, 0.0]), np.array([0.2, 0.4, 0.6]), turn)
    solids = solids_of(Scene("", boxes=(box,), spheres=(Sphere(np.zeros(3), 0.3),)))
    corner, middle = box.centre + turn @ [0.1, 0.2, 0.3], box.centre
    points = np.array([corner + turn @ [0.0, 0.3, 0.4], middle, [0.0, 0.0, 2.0]])
    distances = distances_to_solids(solids, points)
    np.testing.assert_allclose(distances[:2, 0], [0.5, 0.0], atol=1e-12)
    np.testing.assert_allclose(distances[2, 1], 1.7)
