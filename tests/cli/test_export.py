"""`beamseg export`, `beamseg view` and `beamseg run --record`."""

from __future__ import annotations

import sys
from pathlib import Path

import numpy as np
import pytest
from rosbags.highlevel import AnyReader
from rosbags.typesys import Stores, get_typestore

from beamseg_batch.cli.main import COMMANDS
from beamseg_batch.config import OutputConfig, RunConfig
from beamseg_batch.outputs import write_run
from beamseg_batch.viewing import NoPictureError
from tests.cli.conftest import CLOUDS_NS, N_CLOUDS
from tests.outputs.conftest import build_flight


@pytest.fixture(scope="session")
def run_folder(tmp_path_factory) -> Path:
    folder = tmp_path_factory.mktemp("runs") / "out"
    write_run(build_flight(), folder)
    return folder


@pytest.fixture(scope="session")
def run_without_report(tmp_path_factory) -> Path:
    folder = tmp_path_factory.mktemp("runs") / "out"
    write_run(build_flight(config=RunConfig(outputs=OutputConfig(report=False))), folder)
    return folder


def test_export__says_what_it_wrote(call, run_folder, tmp_path):
    file = tmp_path / "structure.json"
    result = call("export", run_folder, "--to", file)
    assert (result.exit_code, result.stdout) == (0, f"9 members in {file}\n")
    assert file.is_file()


def test_export__quiet(call, run_folder, tmp_path):
    result = call("export", run_folder, "--to", tmp_path / "s.json", "-q")
    assert (result.exit_code, result.output) == (0, "")


def test_export__where_the_world_lies(call, run_folder, tmp_path):
    file = tmp_path / "map.geojson"
    result = call("export", run_folder, "--to", file, "--origin", "46.5,6.5,400,12.5", "-q")
    assert result.exit_code == 0
    assert "LineString" in file.read_text()


@pytest.mark.parametrize(
    ("origin", "complaint"),
    [
        ("46.5", "write LAT,LON"),
        ("46.5,6.5,1,2,3", "write LAT,LON"),
        ("46.5,east", "write LAT,LON"),
        ("46.5,nan", "write LAT,LON"),
        ("91,6.5", "the latitude is at most 90 degrees"),
    ],
)
def test_export__origin_that_is_none(refused, run_folder, tmp_path, origin, complaint):
    line = refused(2, "export", run_folder, "--to", tmp_path / "m.geojson", "--origin", origin)
    assert complaint in line


def test_export__refuses_in_one_line(refused, run_folder, tmp_path, monkeypatch):
    assert "is of no kind" in refused(2, "export", run_folder, "--to", tmp_path / "s.txt")
    assert "holds no run" in refused(1, "export", tmp_path, "--to", tmp_path / "s.json")
    (tmp_path / "s.json").touch()
    assert "--overwrite" in refused(2, "export", run_folder, "--to", tmp_path / "s.json")
    monkeypatch.setitem(sys.modules, "ezdxf", None)
    line = refused(2, "export", run_folder, "--to", tmp_path / "s.dxf")
    assert line.endswith("pip install 'beamseg-batch[export]'")


@pytest.mark.parametrize("command", ["export", "view"])
def test_help__teaches_with_examples(call, command):
    result = call(command, "--help")
    assert "Examples:" in result.stdout
    assert command in COMMANDS


@pytest.mark.parametrize("name", ["views.mcap", "views.bag"])
def test_run_record__replays_every_scan(call, flight, tmp_path, name):
    file = tmp_path / name
    result = call("run", flight, "-o", tmp_path / "out", "--record", file)
    assert result.exit_code == 0
    assert f"replay of {N_CLOUDS} scans in {file}" in result.stderr
    store = get_typestore(Stores.ROS2_JAZZY)
    with AnyReader([file], default_typestore=store) as reader:
        counts = {topic: info.msgcount for topic, info in reader.topics.items()}
        clouds = [
            reader.deserialize(raw, connection.msgtype)
            for connection, _, raw in reader.messages()
            if connection.topic == "/hough_pointcloud"
        ]
    one_per_scan = {"/markers", "/filtered_pointcloud", "/hough_pointcloud", "/tf"}
    assert {topic: n for topic, n in counts.items() if topic in one_per_scan} == dict.fromkeys(
        one_per_scan, N_CLOUDS
    )
    stamps = [c.header.stamp.sec * 10**9 + c.header.stamp.nanosec for c in clouds]
    assert stamps == CLOUDS_NS
    assert all(cloud.width > 10 for cloud in clouds)
    points = np.frombuffer(bytes(clouds[0].data), "<f4").reshape(-1, 3)
    np.testing.assert_allclose(points[:, 0], 1.0, atol=0.02)


def test_run_record__refuses_before_it_works(refused, flight, tmp_path):
    out = ("-o", tmp_path / "out")
    assert ".mcap or .bag" in refused(2, "run", flight, *out, "--record", tmp_path / "v.txt")
    itself = refused(2, "run", flight, *out, "--record", flight, "--overwrite")
    assert "would replace or change the recording" in itself
    (tmp_path / "v.bag").touch()
    assert "--overwrite" in refused(2, "run", flight, *out, "--record", tmp_path / "v.bag")
    assert not (tmp_path / "out").exists()


@pytest.fixture
def launched(monkeypatch) -> list[str]:
    """Give what a browser was asked to open."""
    opened: list[str] = []
    monkeypatch.setattr("click.launch", opened.append)
    return opened


@pytest.fixture
def no_display(monkeypatch):
    monkeypatch.setattr("beamseg_batch.viewing.has_display", lambda: False)
    monkeypatch.delenv("BROWSER", raising=False)


def test_view__without_a_display_names_the_report(call, run_folder, no_display, launched):
    result = call("view", run_folder)
    assert (result.exit_code, result.stdout) == (0, f"{run_folder / 'report.html'}\n")
    assert "no display" in result.stderr
    assert launched == []


def test_view__a_browser_elsewhere_opens_the_report(
    call, run_folder, no_display, launched, monkeypatch
):
    monkeypatch.setenv("BROWSER", "remote-browser")
    assert call("view", run_folder).exit_code == 0
    assert launched == [str(run_folder / "report.html")]


def test_view__without_open3d_opens_the_report(call, run_folder, launched, monkeypatch):
    monkeypatch.setattr("beamseg_batch.viewing.has_display", lambda: True)
    monkeypatch.setitem(sys.modules, "open3d", None)
    result = call("view", run_folder)
    assert result.exit_code == 0
    assert "a window needs Open3D" in result.stderr
    assert launched == [str(run_folder / "report.html")]


def test_view__neither_window_nor_report(refused, run_without_report, no_display):
    assert "holds no report.html either" in refused(1, "view", run_without_report)


def test_view__a_picture_without_a_display(call, run_folder, tmp_path):
    open3d = pytest.importorskip("open3d", exc_type=ImportError)
    file = tmp_path / "structure.png"
    result = call("view", run_folder, "--screenshot", file)
    if result.exit_code == 1 and "neither a display nor EGL" in result.stderr:
        pytest.skip("nothing can render here")
    assert (result.exit_code, result.stdout) == (0, f"{file}\n")
    pixels = np.asarray(open3d.io.read_image(str(file)))
    assert pixels.shape[:2] == (1000, 1600)
    blue = (pixels[..., 2].astype(int) - pixels[..., 0]) > 30
    assert 0.002 < blue.mean() < 0.5


def test_view__a_picture_that_cannot_be(refused, run_folder, tmp_path, monkeypatch):
    assert ".png" in refused(2, "view", run_folder, "--screenshot", tmp_path / "a.jpg")
    (tmp_path / "a.png").touch()
    assert "--overwrite" in refused(2, "view", run_folder, "--screenshot", tmp_path / "a.png")
    monkeypatch.setitem(sys.modules, "open3d", None)
    line = refused(2, "view", run_folder, "--screenshot", tmp_path / "b.png")
    assert "a picture needs Open3D" in line
    assert not (tmp_path / "b.png").exists()


def test_view__nothing_renders(refused, run_folder, tmp_path, monkeypatch):
    def no_window(*_, **__):
        raise NoPictureError("Open3D cannot make a picture on this machine")

    monkeypatch.setattr("beamseg_batch.viewing._window", no_window)
    line = refused(1, "view", run_folder, "--screenshot", tmp_path / "b.png")
    assert line == "Open3D cannot make a picture on this machine"
    assert list(tmp_path.iterdir()) == []
