"""Scenes: one description, a live figure and still pictures from four sides."""

from __future__ import annotations

import base64
from xml.etree import ElementTree

import numpy as np
import pytest

from beamseg_batch.pages.figures import VIEWS
from beamseg_batch.pages.scenes import Cylinders, Marks, Path, Points, Scene, Shade

VIEW = {view.name: view for view in VIEWS}
ENDS = np.array([[[0, 0, 0], [0, 0, 4]], [[0, 0, 4], [2, 0, 4]]], dtype=float)
RADII = np.array([0.1, 0.05])


def scene(**more):
    beams = Cylinders("beams", "$beam", ENDS, RADII, ["<b>0</b>", "1"], **more)
    return Scene((beams,), ENDS.reshape(-1, 3), "two beams")


def drawn(picture, name="line"):
    """Elements that are not the edges that set lines off."""
    found = [e for e in ElementTree.fromstring(picture).iter() if e.tag == name]
    return [e for e in found if e.get("stroke") != "var(--card)"]


def line(element):
    return np.array([float(element.get(name)) for name in ("x1", "y1", "x2", "y2")]).reshape(2, 2)


@pytest.mark.parametrize(
    ("view", "towards"),
    [("top", [0, 0, 1]), ("front", [0, -1, 0]), ("side", [1, 0, 0])],
)
def test_view__its_axes_are_a_right_handed_frame(view, towards):
    axes = VIEW[view].axes
    np.testing.assert_allclose(axes @ axes.T, np.eye(3), atol=1e-12)
    assert np.linalg.det(axes) == pytest.approx(1.0)
    np.testing.assert_allclose(axes[2], towards, atol=2e-3)


def test_scene_picture__front_view_shows_x_and_z_to_scale():
    post, arm = map(line, drawn(scene().picture(VIEW["front"])))
    (dx, dy), (ex, ey) = np.diff(post, axis=0)[0], np.diff(arm, axis=0)[0]
    assert dx == pytest.approx(0.0, abs=0.11)
    assert ey == pytest.approx(0.0, abs=0.11)
    assert ex == pytest.approx(-dy / 2, abs=0.2)  # to the right, half as long as the post is high


def test_scene_picture__cylinders_are_as_thick_as_they_are():
    for element, radius in zip(drawn(scene().picture(VIEW["front"])), RADII, strict=True):
        scale = np.linalg.norm(np.diff(line(element), axis=0)) / (4.0 if radius == 0.1 else 2.0)
        assert float(element.get("stroke-width")) == pytest.approx(2 * radius * scale, abs=0.1)


def test_scene_picture__what_is_near_is_drawn_last():
    far_first = np.array([[[0, 1, 0], [1, 1, 1]], [[0, -1, 0], [1, -1, 1]]], dtype=float)
    shade = Shade(("far", "near"), ("$cloud", "$bad"), (0, 1))
    for ends, of in ((far_first, (0, 1)), (far_first[::-1], (1, 0))):
        shades = {"distance": Shade(shade.names, shade.colours, of)}
        beams = Cylinders("beams", "$beam", ends, RADII, ["a", "b"], shades)
        picture = Scene((beams,), ends.reshape(-1, 3), "two").picture(VIEW["front"])
        assert [e.get("stroke") for e in drawn(picture)] == ["var(--cloud)", "var(--bad)"]


def test_scene_picture__hidden_parts_and_clouds_are_left_out():
    hidden = Cylinders("members", "$path", ENDS, RADII, ["a", "b"], hidden=True)
    cloud = Points("cloud", "$cloud", np.zeros((5, 3)))
    made = Scene((hidden, cloud), np.zeros((1, 3)), "nothing")
    assert drawn(made.picture(VIEWS[0])) == []
    assert "nan" not in made.picture(VIEWS[0])
    assert [trace["name"] for trace in made.figure()["data"]] == ["members", "cloud"]
    assert made.figure()["data"][0]["visible"] == "legendonly"


def test_scene_picture__names_marks_and_paths():
    beams = Cylinders("beams", "$beam", ENDS, RADII, ["a", "b"], named=["7", "<8>"])
    marks = Marks("joints", "$joint", ENDS[:1, 1], np.array([0.2]), ["joint"])
    path = Path("trajectory", "$path", np.array([[0, -1, 0], [3, -1, 2.0]]))
    picture = Scene((beams, marks, path), ENDS.reshape(-1, 3), "all").picture(VIEWS[0])
    names = [e.text for e in drawn(picture, "text")]
    assert {"7", "<8>"} <= set(names)
    assert [e.get("fill") for e in drawn(picture, "circle")] == ["var(--joint)"]
    assert any(e.get("stroke") == "var(--path)" for e in drawn(picture, "path"))


def test_scene_figure__a_label_and_a_colour_per_body():
    shades = {"quality": Shade(("good", "poor"), ("$good", "$bad"), (0, 1))}
    (trace,) = scene(shades=shades).figure()["data"]
    assert trace["meta"]["labels"] == ["<b>0</b>", "1"]
    assert trace["meta"]["shades"]["quality"]["of"] == (0, 1)
    assert sum(trace["meta"]["counts"]) * 4 == len(base64.b64decode(trace["x"]["bdata"]))


def test_scene_figure__every_view_has_a_camera_that_looks_its_way():
    layout = scene().figure()["layout"]
    assert list(layout["meta"]["cameras"]) == [view.name for view in VIEWS]
    for view in VIEWS:
        camera = layout["meta"]["cameras"][view.name]
        eye, centre = (np.array(list(camera[key].values())) for key in ("eye", "center"))
        towards = (eye - centre) / np.linalg.norm(eye - centre)
        np.testing.assert_allclose(towards, view.axes[2], atol=2e-3)
    assert layout["scene"]["camera"] == layout["meta"]["cameras"]["iso"]


def test_scene_drawing__has_all_forms():
    drawing = scene().drawing
    assert len(drawing.pictures) == 4
    assert drawing.description == "two beams"
    assert drawing.figure == scene().figure()
