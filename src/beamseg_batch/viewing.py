"""A run in a window or in a picture, by Open3D."""

from __future__ import annotations

import os
import sys
import tempfile
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from itertools import chain
from pathlib import Path
from typing import Any

import numpy as np

from beamseg_batch.bars import bars_of
from beamseg_batch.errors import BeamsegError, OutputError
from beamseg_batch.extras import load_open3d
from beamseg_batch.geometry import FloatArray
from beamseg_batch.outputs import Run
from beamseg_batch.outputs.single_file import staged_file
from beamseg_batch.prisms import mesh_of
from beamseg_batch.tables import JOINTS

__all__ = ["NoPictureError", "has_display", "save_picture", "show_window"]

_PALETTE = (
    (0.27, 0.51, 0.71), (0.93, 0.55, 0.23), (0.33, 0.63, 0.41), (0.58, 0.42, 0.70),
    (0.55, 0.43, 0.36), (0.84, 0.47, 0.67),
)  # fmt: skip
"""Colours of the beams, one for each cross-section in turn."""
_JOINT, _CLOUD, _PATH = (0.84, 0.19, 0.15), (0.62, 0.64, 0.67), (0.25, 0.25, 0.25)
_FRONT, _UP, _ZOOM = (0.55, -0.75, 0.36), (0.0, 0.0, 1.0), 0.6
_LEAST_BALL = 0.03
_POINT_PIXELS = 2.0


class NoPictureError(BeamsegError, RuntimeError):
    """Nothing on this machine can render a picture."""


def has_display() -> bool:
    """Whether a window could open: there is a screen, as far as the environment tells."""
    if sys.platform in ("darwin", "win32"):
        return True
    return bool(os.environ.get("DISPLAY") or os.environ.get("WAYLAND_DISPLAY"))


def show_window(run: Run) -> None:
    """Show a run in a window, until it is closed.

    Parameters
    ----------
    run : Run

    Raises
    ------
    Open3DMissingError
        If Open3D cannot be loaded.
    NoPictureError
        If it cannot open a window.
    RunError
        If a file of the run cannot be read.
    """
    with _window(run, "a window", visible=True) as window:
        window.run()


def save_picture(
    run: Run, path: Path, size: tuple[int, int] = (1600, 1000), *, overwrite: bool = False
) -> None:
    """Save a picture of a run; no display is needed.

    Parameters
    ----------
    run : Run
    path : Path
        A PNG file.
    size : (int, int), optional
        Width and height, pixels.
    overwrite : bool, optional

    Raises
    ------
    OutputError
        If the name does not end in ``.png``, the file is there already, or it cannot be
        written.
    Open3DMissingError, NoPictureError, RunError
        As `show_window` does.
    """
    if path.suffix.lower() != ".png":
        raise OutputError(f"{path}: a picture is a PNG file: end its name in .png")
    with (
        staged_file(path, overwrite=overwrite) as staged,
        _window(run, "a picture", visible=False, size=size) as window,
    ):
        window.capture_screen_image(str(staged), do_render=True)
        if not staged.is_file():
            raise NoPictureError(f"{path}: Open3D rendered nothing; look at report.html instead")


@contextmanager
def _window(
    run: Run, purpose: str, *, visible: bool, size: tuple[int, int] = (1600, 1000)
) -> Iterator[Any]:
    open3d = load_open3d(purpose)
    os.environ.setdefault("XDG_RUNTIME_DIR", tempfile.gettempdir())  # OpenGL complains without
    things = _Things(open3d, run)
    with open3d.utility.VerbosityContextManager(open3d.utility.VerbosityLevel.Error):
        window = open3d.visualization.Visualizer()
        opened = window.create_window(f"{run.folder}", *size, visible=visible)
        try:
            if not opened:
                raise NoPictureError(
                    f"Open3D cannot make {purpose} on this machine: it found neither a display nor "
                    "EGL; look at report.html instead"
                )
            for thing in things.all():
                window.add_geometry(thing)
            window.get_render_option().point_size = _POINT_PIXELS
            window.get_render_option().mesh_show_back_face = True
            camera = window.get_view_control()
            camera.set_lookat(things.centre)
            camera.set_front(_FRONT)
            camera.set_up(_UP)
            camera.set_zoom(_ZOOM)
            yield window
        finally:
            window.destroy_window()


@dataclass(frozen=True, eq=False)
class _Things:
    """What of a run is shown: beams, joints, cloud, the drone's path."""

    open3d: Any
    run: Run

    def all(self) -> Iterator[Any]:
        yield from chain(self._beams(), self._joints(), self._cloud(), self._path())

    @property
    def centre(self) -> FloatArray:
        """(3,) float64: middle of the beams, else of the cloud, else of the path."""
        ends = [end for segment in self.run.segments for end in (segment.end_1, segment.end_2)]
        for points in (
            np.array(ends).reshape(-1, 3),
            self._points("cloud"),
            self._points("trajectory_position"),
        ):
            if len(points):
                middle: FloatArray = (points.min(axis=0) + points.max(axis=0)) / 2.0
                return middle
        return np.zeros(3)

    def _beams(self) -> Iterator[Any]:
        bars = bars_of(self.run.columns, "beams")
        sections = list(dict.fromkeys(bar.section for bar in bars))
        for bar in bars:
            mesh = mesh_of(bar)
            corners = mesh.vertices[mesh.triangles].reshape(-1, 3)  # none shared: edges stay sharp
            solid = self.open3d.geometry.TriangleMesh(
                self.open3d.utility.Vector3dVector(corners),
                self.open3d.utility.Vector3iVector(
                    np.arange(len(corners), dtype=np.int32).reshape(-1, 3)
                ),
            )
            solid.compute_vertex_normals()
            solid.paint_uniform_color(_PALETTE[sections.index(bar.section) % len(_PALETTE)])
            yield solid

    def _joints(self) -> Iterator[Any]:
        columns = self.run.columns[JOINTS.name]
        radii = [segment.radius for segment in self.run.segments]
        radius = max([_LEAST_BALL, *(1.3 * radius for radius in radii)])
        for position in np.column_stack([columns[axis] for axis in "xyz"]):
            ball = self.open3d.geometry.TriangleMesh.create_sphere(radius)
            ball.compute_vertex_normals()
            ball.paint_uniform_color(_JOINT)
            yield ball.translate(position)

    def _cloud(self) -> Iterator[Any]:
        points = self._points("cloud")
        if len(points):
            cloud = self.open3d.geometry.PointCloud(self.open3d.utility.Vector3dVector(points))
            yield cloud.paint_uniform_color(_CLOUD)

    def _path(self) -> Iterator[Any]:
        points = self._points("trajectory_position")
        if len(points) > 1:
            steps = np.column_stack([np.arange(len(points) - 1), np.arange(1, len(points))])
            path = self.open3d.geometry.LineSet(
                self.open3d.utility.Vector3dVector(points),
                self.open3d.utility.Vector2iVector(steps.astype(np.int32)),
            )
            yield path.paint_uniform_color(_PATH)

    def _points(self, name: str) -> FloatArray:
        """Points of `structure.npz` that are numbers."""
        points = self.run.structure[name].astype(np.float64)
        finite: FloatArray = points[np.isfinite(points).all(axis=1)]
        return finite
