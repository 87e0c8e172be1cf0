"""Scenes: one description, a live figure and still pictures from four sides."""

from __future__ import annotations

import base64
from xml.etree import ElementTree

import numpy as np
import pytest

from beamseg_batch.geometry import section_frame
from beamseg_batch.pages.figures import VIEWS
from beamseg_batch.pages.scenes import Bars, Marks, Path, Points, Scene, Shade
from beamseg_batch.prisms import Prism, outline, round_prism
from beamseg_batch.section import Section

VIEW = {view.name: view for view in VIEWS}
ENDS = np.array([[[0, 0, 0], [0, 0, 4]], [[0, 0, 4], [2, 0, 4]]], dtype=float)
RADII = np.array([0.1, 0.05])


def bars(name, colour, ends, labels, *shades, **more):
    prisms = [round_prism(*pair, radius) for pair, radius in zip(ends, RADII, strict=True)]
    return Bars(name, colour, prisms, labels, *shades, **more)


def scene(**more):
    beams = bars("beams", "$beam", ENDS, ["<b>0</b>", "1"], **more)
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


def test_scene_picture__bars_are_as_thick_as_they_are():
    for element, radius in zip(drawn(scene().picture(VIEW["front"])), RADII, strict=True):
        scale = np.linalg.norm(np.diff(line(element), axis=0)) / (4.0 if radius == 0.1 else 2.0)
        assert float(element.get("stroke-width")) == pytest.approx(2 * radius * scale, abs=0.1)


@pytest.mark.parametrize(("turn", "width"), [(0.0, 0.1), (0.5 * np.pi, 0.3)])
def test_scene_picture__a_section_is_as_wide_as_it_looks_from_there(turn, width):
    post = Prism(
        Section("l", 0.1, 0.3, 0.01, 0.01), ENDS[0], section_frame(np.array([0, 0, 1.0]), turn)
    )
    picture = Scene((Bars("beams", "$beam", [post], [""]),), ENDS[0], "a post").picture(
        VIEW["front"]
    )
    (element,) = drawn(picture)
    scale = np.linalg.norm(np.diff(line(element), axis=0)) / 4.0
    assert float(element.get("stroke-width")) == pytest.approx(width * scale, abs=0.1)


def test_scene_picture__a_bent_bar_is_bent_and_a_section_off_its_axis_beside_it():
    share = np.linspace(0.0, 1.0, 101)[:, None]
    nodes = share * [0.0, 0.0, 4.0] + 4.0 * share * (1.0 - share) * [0.5, 0.0, 0.0]
    upright = section_frame(np.array([0.0, 0.0, 1.0]))
    routes = []
    for section in (Section("round", 0.2, 0.2), Section("l", 0.2, 0.2, 0.02, 0.02)):
        part = Bars("beams", "$beam", [Prism(section, nodes, upright)], [""])
        picture = Scene((part,), np.array([[0.0, 0, 0], [0, 0, 4]]), "bent").picture(VIEW["front"])
        (route,) = (e for e in drawn(picture, "path") if e.get("stroke") == "var(--beam)")
        routes.append(np.array([p.split(" ") for p in route.get("d")[1:].split("L")], float))
    bent, aside = routes
    scale = (bent[0, 1] - bent[-1, 1]) / 4.0
    assert np.ptp(bent[:, 0]) == pytest.approx(0.5 * scale, abs=0.02 * scale)
    extents = outline(Section("l", 0.2, 0.2, 0.02, 0.02))[:, 0]
    middle = 0.5 * (extents.min() + extents.max())
    np.testing.assert_allclose(aside[:, 0] - bent[:, 0], middle * scale, atol=0.11)


def test_scene_picture__what_is_near_is_drawn_last():
    far_first = np.array([[[0, 1, 0], [1, 1, 1]], [[0, -1, 0], [1, -1, 1]]], dtype=float)
    shade = Shade(("far", "near"), ("$cloud", "$bad"), (0, 1))
    for ends, of in ((far_first, (0, 1)), (far_first[::-1], (1, 0))):
        shades = {"distance": Shade(shade.names, shade.colours, of)}
        beams = bars("beams", "$beam", ends, ["a", "b"], shades)
        picture = Scene((beams,), ends.reshape(-1, 3), "two").picture(VIEW["front"])
        assert [e.get("stroke") for e in drawn(picture)] == ["var(--cloud)", "var(--bad)"]


def test_scene_picture__hidden_parts_and_clouds_are_left_out():
    hidden = bars("members", "$path", ENDS, ["a", "b"], hidden=True)
    cloud = Points("cloud", "$cloud", np.zeros((5, 3)))
    made = Scene((hidden, cloud), np.zeros((1, 3)), "nothing")
    assert drawn(made.picture(VIEWS[0])) == []
    assert "nan" not in made.picture(VIEWS[0])
    assert [trace["name"] for trace in made.figure()["data"]] == ["members", "cloud"]
    assert made.figure()["data"][0]["visible"] == "legendonly"


def test_scene_picture__names_marks_and_paths():
    beams = bars("beams", "$beam", ENDS, ["a", "b"], named=["7", "<8>"])
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
