"""The report: one page that says what was done and asks nobody for anything."""

from __future__ import annotations

import base64
import dataclasses
import gzip
import itertools
import json
import re
from collections import Counter
from html.parser import HTMLParser
from pathlib import Path

import numpy as np
import pytest
from plotly.offline import get_plotlyjs

from beamseg_batch.geometry import section_frame
from beamseg_batch.model import CrossSection
from beamseg_batch.outputs.columns import segment_columns
from beamseg_batch.outputs.figures import structure_scene
from beamseg_batch.outputs.fly_again import plan_flight
from beamseg_batch.outputs.report import MAX_TABLE_ROWS, render_report
from beamseg_batch.outputs.summary import summarise
from beamseg_batch.pages.drawing import Drawing
from beamseg_batch.pages.rendering import Html
from beamseg_batch.pages.rendering import Section as PageSection
from beamseg_batch.prisms import outline
from beamseg_batch.section import Section
from beamseg_batch.tables import SEGMENTS
from tests.outputs.conftest import build_flight

FIGURES = ["structure", "processing", "by-lines", "points", "lines", "size", "gaps"]
HOSTILE = "</script><script>alert('x')</script><img src=x onerror=alert(1)>&\"{{ 7*7 }}"


class Page(HTMLParser):
    """Elements, attributes and the text of a page."""

    def __init__(self, html):
        super().__init__()
        self.tags: Counter[str] = Counter()
        self.attributes: list[tuple[str, str, str]] = []
        self.scripts: list[str] = []
        self.styles: list[str] = []
        self.text = ""
        self._open = ""
        self.feed(html)

    def handle_starttag(self, tag, attributes):
        self.tags[tag] += 1
        self.attributes += [(tag, name, value or "") for name, value in attributes]
        self._open = tag
        if tag == "script":
            self.scripts.append("")

    def handle_endtag(self, tag):
        self._open = ""

    def handle_data(self, data):
        if self._open == "script":
            self.scripts[-1] += data
        elif self._open == "style":
            self.styles.append(data)
        else:
            self.text += data

    @property
    def figures(self):
        return json.loads(self.scripts[1])


def decoded(typed):
    kind = np.dtype(typed["dtype"]).newbyteorder("<")
    return np.frombuffer(base64.b64decode(typed["bdata"]), dtype=kind)


def trace(figures, name):
    return next(t for t in figures["structure"]["data"] if t["name"] == name)


def scene(flight):
    return structure_scene(flight, plan_flight(flight)).figure()


@pytest.fixture(scope="module")
def html():
    """Report of the flight that the fixture `flight` gives."""
    return render_report(build_flight())


@pytest.fixture(scope="module")
def page(html):
    return Page(html)


def test_render_report__requests_nothing(page):
    addresses = {"src", "href", "srcset", "action", "data", "poster", "background", "ping"}
    assert [e for e in page.attributes if e[1] in addresses and e[2][0] != "#"] == []
    assert page.tags.keys().isdisjoint({"link", "iframe", "base", "object", "embed", "form"})
    assert not re.search(r"@import|url\(", "".join(page.styles))
    policy = next(v for tag, name, v in page.attributes if tag == "meta" and "default-src" in v)
    assert policy.startswith("default-src 'none'")
    assert "http" not in policy
    assert "http" not in page.scripts[2]


def test_render_report__offers_no_upload(page):
    assert "showSendToCloud: false" in page.scripts[2]
    assert 'plotlyServerURL: ""' in page.scripts[2]


def test_render_report__plotly_is_in_it_once_and_packed(page):
    assert len(page.scripts) == 3
    unpacked = gzip.decompress(base64.b64decode(page.scripts[0])).decode()
    assert unpacked == get_plotlyjs()
    assert "plotly.js v" not in page.scripts[1] + page.scripts[2]


def test_render_report__links_lead_to_what_is_there(page):
    ids = {value for _, name, value in page.attributes if name == "id"}
    links = [value[1:] for tag, name, value in page.attributes if (tag, name) == ("a", "href")]
    assert len(links) >= 6
    assert ids.issuperset(links)


def test_render_report__flight_of_an_hour_is_under_8_megabytes(make_flight):
    html = render_report(make_flight(n_segments=600, n_scans=12_000, n_cloud=200_000))
    figures = Page(html).figures
    assert len(html.encode()) < 7_000_000
    assert len(decoded(trace(figures, "cloud")["x"])) == 30_000
    assert len(decoded(figures["processing"]["data"][0]["y"])) <= 3_002


def test_render_report__far_too_many_beams_are_still_under_8_megabytes(make_flight):
    flight = make_flight(n_segments=5000, n_scans=3_500, n_cloud=40_000)
    joints, intersections = flight.joints * 4, flight.intersections * 4
    html = render_report(dataclasses.replace(flight, intersections=intersections, joints=joints))
    assert len(html.encode()) < 8_000_000
    assert "The first 2000 of 5000 beams are drawn." in html
    assert f"The first {MAX_TABLE_ROWS} of 5000; <code>segments.csv</code>" in html


def rows_of(html, table):
    """Cells of a table of the page, row by row, each by the name of its column."""
    part = re.search(rf'<div class="listing" id="{table}-table">.*?</table>', html, re.DOTALL)[0]
    names = re.findall(r'<th [^>]*data-name="([^"]*)"', part)
    return [
        dict(
            zip(
                names,
                [re.sub("<.*?>", "", cell) for cell in re.findall(r"<td.*?>(.*?)</td>", row)],
                strict=True,
            )
        )
        for row in re.findall(r"<tr(?: data-beam=\"\d+\")?>(?=<td)(.*?)</tr>", part)
    ]


def test_render_report__lists_and_draws_the_joints(page, html, flight):
    rows = rows_of(html, "joints")
    for number, joint in enumerate(flight.joints):
        row = rows[number]
        place = [f"{value:.3f}" for value in joint.position]
        assert [row["joint"], row["x"], row["y"], row["z"]] == [str(number), *place]
        assert row["segments"] == ";".join(map(str, joint.segments))
        assert row["residual"] == "15.50"
        assert row["sigma_z"] == f"{1e3 * np.sqrt(joint.covariance[2, 2]):.2f}"
    drawn = trace(page.figures, "joints")
    centres = np.stack([decoded(drawn[axis]) for axis in "xyz"], axis=1)
    vertices = len(centres) // len(flight.joints)
    for joint, corners in zip(
        flight.joints, np.split(centres, len(centres) // vertices), strict=True
    ):
        np.testing.assert_allclose(corners.mean(axis=0), joint.position, atol=1e-5)


def test_render_report__says_what_was_processed(page):
    text = " ".join(page.text.split())
    for expected in (
        "arena.mcap",
        "ROS 2 MCAP",
        "20.0 s",
        "30 of 35 scans used, 5 skipped",
        "no_pose_within_gap",
        "n_points",
        "/mavros/local_position/pose",
        "pico_zense_depth_frame",
        "3 clouds have no pose within 0.05 s",
        "floor_trim_height",
        "0.071, 0.011, 0.040 m (tf_static)",
    ):
        assert expected in text


def test_render_report__figures_are_valid_plotly(page):
    graph_objects = pytest.importorskip("plotly.graph_objects")
    assert list(page.figures) == [*FIGURES, "sigma-offset", "sigma-angle", "sigma-end"]
    for figure in page.figures.values():
        text = re.sub(r'"\$\w+"', '"red"', json.dumps(figure))
        graph_objects.Figure(json.loads(text))


def test_render_report__times_are_true_milliseconds(page, flight):
    times_ms = decoded(page.figures["processing"]["data"][0]["y"])
    expected = [scan.processing_us / 1000 for scan in flight.scans]
    np.testing.assert_allclose(times_ms, expected, rtol=1e-6)


def test_render_report__a_box_per_number_of_lines(page, flight):
    figure = page.figures["by-lines"]
    (boxes,) = figure["data"]
    times = {"all": [scan.processing_us / 1000 for scan in flight.scans]}
    for scan in sorted(flight.scans, key=lambda scan: scan.n_lines):
        times.setdefault(str(scan.n_lines), []).append(scan.processing_us / 1000)
    assert figure["layout"]["xaxis"]["ticktext"] == list(times)
    for name, share in (("q1", 25), ("median", 50), ("q3", 75)):
        expected = [np.percentile(values, share) for values in times.values()]
        np.testing.assert_allclose(decoded(boxes[name]), expected, rtol=1e-6)


def test_render_report__all_columns_of_the_beams_are_there(html, flight):
    (first, *_) = rows_of(html, "segments")
    assert set(first) == {*SEGMENTS.column_names, "quality", "remarks"}
    beam = flight.segments[0]
    assert first["length"] == f"{beam.length:.3f}"
    assert first["sigma_radius"] == f"{1e3 * beam.sigma_radius:.2f}"
    assert first["end_1_seen"] == ("yes" if beam.ends_seen[0] else "no")


def test_render_report__shows_deviations_or_else_the_form_of_the_points(make_flight):
    known = make_flight(n_segments=2)
    unknown = dataclasses.replace(
        known,
        segments=tuple(
            dataclasses.replace(
                beam,
                covariance=np.full((6, 6), np.nan),
                sigma_ends=np.full(2, np.nan),
                ends_seen=None,
            )
            for beam in known.segments
        ),
    )
    for flight, shown, hidden in (
        (known, "sigma_offset", "pca_coeff"),
        (unknown, "pca_coeff", "sigma_offset"),
    ):
        html = render_report(flight)
        assert re.search(rf'<th [^>]*class="" data-name="{shown}"', html)
        assert re.search(rf'<th [^>]*class="m" data-name="{hidden}"', html)
    assert "How sure they are is not known with this profile." in html


def test_render_report__a_bent_beam_stands_out(make_flight, monkeypatch):
    def columns(segments, origin_ns):
        bows = {"bow": np.array([0.012, 0.012, 0.004]), "sigma_bow": np.array([0.001, 0.02, 0.001])}
        return segment_columns(segments, origin_ns) | bows

    monkeypatch.setattr("beamseg_batch.outputs.report.segment_columns", columns)
    html = render_report(make_flight(n_segments=3))
    remarks = [row["remarks"] for row in rows_of(html, "segments")]
    assert [text.startswith("bent") for text in remarks] == [True, False, False]
    assert "1 is bent." in " ".join(html.split())
    shades = trace(Page(html).figures, "beams")["meta"]["shades"]["shape"]
    assert [shades["names"][kind] for kind in shades["of"]] == ["bent", "round", "round"]


def test_render_report__beams_are_coloured_by_quality_shape_and_time(page, flight):
    meta = trace(page.figures, "beams")["meta"]
    assert list(meta["shades"]) == ["quality", "shape", "first seen"]
    for shade in meta["shades"].values():
        assert len(shade["of"]) == len(flight.segments) == len(meta["labels"])
        assert max(shade["of"]) < len(shade["names"]) == len(shade["colours"])
    periods = meta["shades"]["first seen"]["of"]
    seen = [beam.first_seen_ns for beam in flight.segments]
    assert [periods[row] for row in np.argsort(seen)] == sorted(periods)


def test_render_report__more_sections(flight):
    drawing = Drawing({"data": [], "layout": {}}, ("<svg></svg>",), "nothing")
    html = render_report(
        flight, sections=[PageSection("more", "And more", Html("<b>so</b>"), {"x": drawing})]
    )
    page = Page(html)
    assert "And more" in page.text
    assert "x" in page.figures
    assert ("section", "id", "more") in page.attributes


def test_render_report__every_figure_has_words_and_a_still_picture(page):
    assert page.tags["figure"] == len(page.figures)
    labels = [v for tag, name, v in page.attributes if (tag, name) == ("div", "aria-label")]
    assert all(labels)
    pictures = [v for tag, name, v in page.attributes if (tag, name) == ("svg", "aria-label")]
    assert len(pictures) == len(page.figures) + 3  # the structure is seen from four sides


def test_render_report__says_how_to_make_the_run_again(page, flight):
    text = " ".join(page.text.split())
    assert "beamseg run arena.mcap -c config.yaml -o again" in text
    assert flight.recording.sha256 in text


def test_render_report__tells_what_else_the_summary_knows_of_the_camera(flight):
    summary = summarise(flight, (), "")
    summary["sensor"] = {"noise_m": 0.0123, "pose_jitter": {"source": "measured"}}
    text = " ".join(Page(render_report(flight, summary)).text.split())
    assert "noise_m0.0123" in text
    assert "pose_jitter · sourcemeasured" in text


def test_render_report__hostile_names(make_flight, describe_recording):
    recording = describe_recording(
        paths=(Path(HOSTILE.replace("/", "")),),
        container=HOSTILE,
        cloud_topic=HOSTILE,
        pose_topic=HOSTILE,
        sensor_frame=HOSTILE,
        body_frame=HOSTILE,
        world_frame=HOSTILE,
        notes=(HOSTILE,),
    )
    hostile = make_flight(
        recording=recording,
        warnings=(HOSTILE,),
        skipped=Counter({HOSTILE: 1}),
        rejections=Counter({HOSTILE: 1}),
    )
    page, usual = Page(render_report(hostile)), Page(render_report(make_flight()))
    assert page.tags["img"] == 0
    assert page.tags["script"] == usual.tags["script"]
    assert not [entry for entry in page.attributes if entry[1].startswith("on")]
    assert page.text.count(HOSTILE) >= 8


def test_render_report__empty(empty_flight):
    page = Page(render_report(empty_flight))
    assert page.figures == {}
    assert "There is nothing to show" in page.text
    assert "No beam was found." in page.text
    assert "NaN" not in page.text
    assert "None" not in page.text.replace("None.", "")


@pytest.mark.parametrize(
    "sizes",
    [
        {"n_segments": 0, "n_scans": 1, "n_cloud": 1},
        {"n_segments": 1, "n_scans": 1, "n_cloud": 0},
        {"n_segments": 2, "n_scans": 2, "n_cloud": 2},
        {"n_segments": 0, "n_scans": 5, "n_cloud": 0, "intersections": ()},
    ],
)
def test_render_report__small_flights(make_flight, sizes):
    page = Page(render_report(make_flight(**sizes)))
    assert [name for name in page.figures if not name.startswith("sigma")] == FIGURES
    assert "NaN" not in page.scripts[1]


def test_render_report__interrupted(make_flight):
    assert "The flight was not read to its end." in render_report(make_flight(interrupted=True))


def test_render_report__names_files_without_their_folder(make_flight):
    flight = make_flight()
    path = str(flight.recording.paths[0])
    html = render_report(dataclasses.replace(flight, warnings=(f"{path}: damaged",)))
    assert "<li>arena.mcap: damaged</li>" in html
    assert path not in html


def test_render_report__given_summary_is_the_one_it_would_make(flight):
    assert render_report(flight, summarise(flight, (), "")) == render_report(flight)


def test_render_report__cloud_with_missing_points(make_flight):
    cloud = np.array([[np.nan, 0, 0], [1, 2, 3], [np.inf, 0, 0]], dtype=np.float32)
    figures = Page(render_report(make_flight(cloud=cloud))).figures
    assert decoded(trace(figures, "cloud")["x"]).tolist() == [1.0]


def test_structure_scene__has_equal_scales(flight):
    assert scene(flight)["layout"]["scene"]["aspectmode"] == "data"


@pytest.mark.parametrize("stretch", [(1, 1, 1), (10, 1, 0.2), (0.1, 5, 1), (0.2, 0.2, 4)])
def test_structure_scene__camera_sees_all_of_it(make_empty_flight, stretch):
    """The corners of what is shown, seen at plotly's angle of 45 degrees."""
    corners = np.array(list(itertools.product((0.0, 1.0), repeat=3))) * stretch + [3.0, 2.0, 1.0]
    flight = make_empty_flight(cloud=corners.astype(np.float32))
    camera = scene(flight)["layout"]["scene"]["camera"]
    eye, centre = (np.array([camera[k][axis] for axis in "xyz"]) for k in ("eye", "center"))
    extent = np.ptp(corners, axis=0)
    seen = (corners - corners.mean(axis=0)) / np.cbrt(extent.prod()) - eye
    ahead = (centre - eye) / np.linalg.norm(centre - eye)
    right = np.cross(ahead, [0.0, 0.0, 1.0])
    right /= np.linalg.norm(right)
    depth = seen @ ahead * np.tan(np.pi / 8)
    across, upward = np.abs(seen @ right / depth), np.abs(seen @ np.cross(right, ahead) / depth)
    assert depth.min() > 0
    assert 0.6 < max(across.max(), upward.max()) < 0.97


def test_render_report__a_label_per_beam(page):
    mesh = trace(page.figures, "beams")
    assert len(mesh["meta"]["labels"]) == len(mesh["meta"]["counts"]) == 7
    assert sum(mesh["meta"]["counts"]) == len(decoded(mesh["x"]))
    assert decoded(mesh["k"]).max() < len(decoded(mesh["x"]))


def shown(drawn):
    """Vertices of the bodies of a trace, body by body."""
    places = np.stack([decoded(drawn[axis]) for axis in "xyz"], axis=1).astype(float)
    return np.split(places, np.cumsum(drawn["meta"]["counts"])[:-1])


def test_structure_scene__beams_have_their_true_sections_and_bows(make_flight):
    flight = make_flight(n_segments=3)
    i_beam = Section("i", 0.1, 0.2, 0.01, 0.02)
    first, second, third = flight.segments
    across = section_frame(first.direction, 0.4)
    sideways = section_frame(second.direction)[:, 1]
    segments = (
        dataclasses.replace(first, cross_section=CrossSection("i", i_beam, across[:, 0])),
        dataclasses.replace(second, bow_vector=0.05 * sideways, sigma_bow=0.001),
        dataclasses.replace(third, cross_section=CrossSection("unknown")),
    )
    flight = dataclasses.replace(flight, segments=segments)
    figure = scene(flight)
    first_drawn, second_drawn, third_drawn = shown(trace({"structure": figure}, "beams"))
    local = (first_drawn - first.anchor) @ across
    apart = np.linalg.norm(local[:, None, :2] - outline(i_beam), axis=2)
    assert apart.min(axis=1).max() < 1e-5
    assert np.ptp(local[:, 2]) == pytest.approx(first.length, abs=1e-5)
    for beam, drawn in zip(segments[1:], (second_drawn, third_drawn), strict=True):
        t = (drawn - beam.anchor) @ beam.direction
        off = np.linalg.norm(drawn - beam.points_at(t), axis=1)
        np.testing.assert_allclose(off, beam.radius, atol=1e-4)
    members = shown(trace({"structure": figure}, "members"))
    of_first = members[[member.segment for member in flight.members].index(0)]
    assert np.ptp((of_first - first.anchor) @ across[:, 1]) == pytest.approx(0.208, abs=1e-5)
