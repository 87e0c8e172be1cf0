"""Tables to bars, and bars to closed meshes."""

from __future__ import annotations

import numpy as np
import pytest

from beamseg_batch.bars import bars_of, beams_of, section_name
from beamseg_batch.prisms import mesh_of, outline
from beamseg_batch.world.scene import Member, Section

SECTIONS = {
    "round": Section("round", 0.1, 0.1),
    "square": Section("square", 0.1, 0.2),
    "i": Section("i", 0.1, 0.2, 0.01, 0.02),
    "l": Section("l", 0.1, 0.15, 0.01, 0.012),
    "c": Section("c", 0.08, 0.2, 0.01, 0.015),
}
START, END = np.array([1.0, 2.0, 3.0]), np.array([2.0, 2.5, 4.0])


def columns_of(section: Section, roll_deg: float = 20.0, bow: float = 0.0) -> dict:
    """Columns of `segments.csv` with one beam, as a version that knows sections writes them."""
    turned = Member("", START, END, section, np.radians(roll_deg)).rotation
    values = {"segment": 0, "radius": section.radius, "t_min": 0.0, "bow": bow}
    values |= {f"bow_{axis}": bow * turned[k, 1] for k, axis in enumerate("xyz")}
    values["length"] = values["t_max"] = float(np.linalg.norm(END - START))
    values |= {f"{axis}1": START[k] for k, axis in enumerate("xyz")}
    values |= {f"{axis}2": END[k] for k, axis in enumerate("xyz")}
    values |= {name: getattr(section, name) for name in ("width", "height", "web", "flange")}
    columns = {name: np.array([value]) for name, value in values.items()}
    return columns | {"roll_deg": np.array([roll_deg]), "shape": np.array([section.shape], object)}


def volume(mesh) -> float:
    a, b, c = (mesh.vertices[mesh.triangles[:, k]] for k in range(3))
    return float(np.einsum("ni,ni->", a, np.cross(b, c)) / 6.0)


@pytest.mark.parametrize("shape", SECTIONS)
@pytest.mark.parametrize("bow", [0.0, 0.02])
def test_mesh_of__closed_and_as_large_as_the_section(shape, bow):
    section = SECTIONS[shape]
    (bar,) = beams_of(columns_of(section, bow=bow))
    mesh = mesh_of(bar)
    edges = np.concatenate([mesh.triangles[:, [k, (k + 1) % 3]] for k in range(3)])
    directed = {tuple(edge) for edge in edges.tolist()}
    assert len(directed) == len(edges)
    assert {(b, a) for a, b in directed} == directed
    area = sum(w * h for *_, w, h in section.plates()) or 12.0 * 0.05**2 * np.sin(np.pi / 12.0)
    assert volume(mesh) == pytest.approx(area * bar.length, rel=1e-9)


@pytest.mark.parametrize("shape", SECTIONS)
def test_beams_of__stand_as_the_worlds_members_do(shape):
    section = SECTIONS[shape]
    (bar,) = beams_of(columns_of(section, bow=0.03))
    member = Member("", START, END, section, np.radians(20.0), 0.03)
    assert bar.section == section
    np.testing.assert_allclose(bar.nodes, member.nodes, atol=1e-12)
    np.testing.assert_allclose(bar.rotation, member.rotation, atol=1e-12)


def test_outline__round_lies_on_the_circle():
    corners = outline(SECTIONS["round"])
    np.testing.assert_allclose(np.linalg.norm(corners, axis=1), 0.05, atol=1e-15)


@pytest.mark.parametrize("change", [{"shape": "unknown"}, {"web": 0.0}, {"width": np.nan}])
def test_beams_of__round_where_the_section_is_not_known(change):
    columns = columns_of(SECTIONS["i"])
    columns |= {name: np.array([value], object) for name, value in change.items()}
    (bar,) = beams_of(columns)
    assert bar.section == Section("round", 0.2, 0.2)


def test_beams_of__tables_without_sections(run):
    beams = beams_of(run.columns["segments"])
    for beam, segment in zip(beams, run.segments, strict=True):
        np.testing.assert_allclose(beam.nodes, [segment.end_1, segment.end_2], atol=1e-12)
        assert beam.section == Section("round", 2 * segment.radius, 2 * segment.radius)


@pytest.mark.parametrize(("bow", "sigma", "nodes"), [(0.0015, 1e-4, 2), (0.004, 0.001, 2)])
def test_beams_of__a_bow_that_is_small_or_unsure_is_none(bow, sigma, nodes):
    columns = columns_of(SECTIONS["round"], bow=bow) | {"sigma_bow": np.array([sigma])}
    (bar,) = beams_of(columns)
    assert len(bar.nodes) == nodes


def test_bars_of__members_lie_on_their_bowed_beam():
    segments = columns_of(SECTIONS["round"], bow=0.04)
    (beam,) = beams_of(segments)
    cut = 0.4 * beam.length
    members = {
        "segment": np.array([0, 0]),
        "t1": np.array([0.0, cut]),
        "t2": np.array([cut, beam.length]),
    }
    first, second = bars_of({"segments": segments, "members": members}, "members")
    np.testing.assert_allclose(first.start, START, atol=1e-12)
    np.testing.assert_allclose(second.end, END, atol=1e-12)
    np.testing.assert_allclose(first.end, second.start, atol=1e-12)
    rise = 4.0 * 0.04 * 0.4 * 0.6
    off_chord = np.linalg.norm(np.cross(first.end - START, (END - START) / beam.length))
    assert off_chord == pytest.approx(rise, abs=1e-12)


def test_bars_of__leaves_out_what_has_no_length():
    columns = columns_of(SECTIONS["round"])
    columns |= {f"{axis}2": columns[f"{axis}1"] for axis in "xyz"}
    assert bars_of({"segments": columns}, "beams") == []


def test_section_name__in_millimetres():
    assert section_name(SECTIONS["round"]) == "ROUND-D100"
    assert section_name(Section("round", 0.0605, 0.0605)) == "ROUND-D60.5"
    assert section_name(SECTIONS["i"]) == "I-100x200"
