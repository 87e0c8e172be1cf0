"""Where compiled kernels are kept."""

from __future__ import annotations

import os
import subprocess
import sys
import time
from pathlib import Path

import numba
import numpy as np
import pytest

from beamseg_batch import accelerate
from beamseg_batch.accelerate import cache_folder, kernel

PROGRAM = """
import numpy as np
from beamseg_batch.accelerate import cache_folder
from beamseg_batch.cylinder.ray_kernels import finite_depth
finite_depth(0.9, 1.1, 0.0, 0.0, 0.0, -1.0, 1.0)
print(cache_folder())
print(sum(finite_depth.stats.cache_hits.values()))
"""


@pytest.fixture(autouse=True)
def forget_folder():
    cache_folder.cache_clear()
    yield
    cache_folder.cache_clear()


def run_fit(**environment: str) -> tuple[Path, int]:
    """Folder that a fresh interpreter keeps a kernel in, and whether it was found there."""
    kept = {k: v for k, v in os.environ.items() if k not in {"NUMBA_CACHE_DIR", "TMPDIR"}}
    printed = subprocess.run(
        [sys.executable, "-c", PROGRAM],
        env={**kept, **environment},
        check=True,
        capture_output=True,
        text=True,
    ).stdout.split()
    return Path(printed[0]), int(printed[1])


@pytest.mark.skipif(sys.platform != "linux", reason="cache folders are named otherwise there")
def test_kernel__is_compiled_once_for_a_user(tmp_path):
    first, found = run_fit(XDG_CACHE_HOME=str(tmp_path))
    assert found == 0
    assert first.parent == tmp_path / "beamseg-batch"
    assert list(first.rglob("*.nbi"))
    assert run_fit(XDG_CACHE_HOME=str(tmp_path)) == (first, 1)


@pytest.mark.skipif(sys.platform != "linux", reason="cache folders are named otherwise there")
def test_kernel__is_kept_in_the_temporary_folder_if_there_is_no_other(tmp_path):
    blocked = {"XDG_CACHE_HOME": "/dev/null/none", "TMPDIR": str(tmp_path)}
    first, found = run_fit(**blocked)
    assert found == 0
    assert first.parent == tmp_path
    assert first.stat().st_mode & 0o077 == 0
    assert run_fit(**blocked) == (first, 1)


def test_kernel__runs_where_the_folder_asked_for_cannot_be_written():
    run_fit(NUMBA_CACHE_DIR="/dev/null/none")


@pytest.mark.skipif(not hasattr(os, "getuid"), reason="needs Unix permissions")
def test_temporary_cache__does_not_trust_a_folder_that_others_can_write(tmp_path, monkeypatch):
    monkeypatch.setattr(accelerate.tempfile, "gettempdir", lambda: str(tmp_path))
    monkeypatch.setattr(accelerate.tempfile, "tempdir", str(tmp_path))
    trusted = Path(accelerate._temporary_cache())
    trusted.chmod(0o777)
    other = Path(accelerate._temporary_cache())
    assert other != trusted
    assert other.stat().st_mode & 0o077 == 0


def test_cache_folder__is_another_for_other_kernels(tmp_path, monkeypatch):
    monkeypatch.setattr(accelerate.platformdirs, "user_cache_path", lambda *a, **k: tmp_path)
    first = cache_folder()
    cache_folder.cache_clear()
    monkeypatch.setattr(accelerate, "_digest_of_kernels", lambda: "other")
    assert cache_folder() != first
    assert Path(first).is_dir()


def test_cache_folder__removes_old_ones(tmp_path, monkeypatch):
    monkeypatch.setattr(accelerate.platformdirs, "user_cache_path", lambda *a, **k: tmp_path)
    old, recent, foreign = (tmp_path / n for n in ("kernels-old", "kernels-new", "mine"))
    for folder in (old, recent, foreign):
        folder.mkdir()
    then = time.time() - 40 * 86400
    os.utime(old, (then, then))
    os.utime(foreign, (then, then))
    cache_folder()
    assert not old.exists()
    assert recent.exists()
    assert foreign.exists()


def test_kernel__leaves_the_settings_of_others_alone():
    before = numba.config.CACHE_DIR

    @kernel
    def double(values: np.ndarray) -> np.ndarray:
        return 2 * values

    assert before == numba.config.CACHE_DIR
    np.testing.assert_array_equal(double(np.arange(3)), [0, 2, 4])
