"""The output folder: whole or absent, and the user's files are the user's."""

from __future__ import annotations

import errno
import json
import os
from pathlib import Path

import pytest

from beamseg_batch.errors import OutputError
from beamseg_batch.outputs.folder import OutputFolder, encoded, partial_path


def write(path, files, *, overwrite=False):
    """Write files and a manifest that lists them."""
    with OutputFolder(path, overwrite=overwrite) as folder:
        for name, content in files.items():
            folder.write(name, content)
        folder.write("summary.json", json.dumps({"files": [*files, "summary.json"]}))


def fail_with(error, path, *, overwrite=False):
    """Write a file and fail before the folder is complete."""
    with OutputFolder(path, overwrite=overwrite) as folder:
        folder.write("t.csv", "new")
        raise error


def content(path):
    """Every file below a folder, hidden ones too, with its text."""
    return {
        str(file.relative_to(path)): file.read_text()
        for file in sorted(path.rglob("*"))
        if file.is_file()
    }


class StopError(Exception):
    pass


def test_write__missing_parents_are_created(tmp_path):
    write(tmp_path / "a" / "b" / "out", {"t.csv": "1\n", "sub/u.bin": b"2"})
    assert sorted(content(tmp_path)) == [
        "a/b/out/sub/u.bin",
        "a/b/out/summary.json",
        "a/b/out/t.csv",
    ]
    assert content(tmp_path)["a/b/out/sub/u.bin"] == "2"


def test_write__folder_has_the_usual_permissions(tmp_path):
    (tmp_path / "usual").mkdir()
    write(tmp_path / "out", {})
    assert (tmp_path / "out").stat().st_mode == (tmp_path / "usual").stat().st_mode


def test_write__empty_folder_is_fine(tmp_path):
    (tmp_path / "out").mkdir()
    inode = (tmp_path / "out").stat().st_ino
    write(tmp_path / "out", {"t.csv": "1"})
    assert sorted(content(tmp_path)) == ["out/summary.json", "out/t.csv"]
    assert (tmp_path / "out").stat().st_ino == inode


def test_write__working_folder(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    write(Path(), {"t.csv": "1"})
    assert sorted(content(tmp_path)) == ["summary.json", "t.csv"]


def test_write__link_to_a_folder(tmp_path):
    (tmp_path / "real").mkdir()
    (tmp_path / "link").symlink_to("real", target_is_directory=True)
    write(tmp_path / "link", {"t.csv": "1"})
    assert (tmp_path / "link").is_symlink()
    assert sorted(content(tmp_path / "real")) == ["summary.json", "t.csv"]


def test_write__link_to_a_folder_that_does_not_exist_yet(tmp_path):
    (tmp_path / "link").symlink_to("real", target_is_directory=True)
    write(tmp_path / "link", {"t.csv": "1"})
    assert sorted(content(tmp_path / "real")) == ["summary.json", "t.csv"]


@pytest.mark.parametrize("name", ["", ".", "/etc/x", "../x", "a/../../x", "a//b", "a\0b", "C:\\x"])
def test_write__name_that_leads_out(tmp_path, name):
    with OutputFolder(tmp_path / "out") as folder, pytest.raises(ValueError, match="inside"):
        folder.write(name, "")


def test_write__outside_of_the_context(tmp_path):
    with pytest.raises(ValueError, match="not open"):
        OutputFolder(tmp_path / "out").write("t.csv", "")


@pytest.mark.parametrize("error", [StopError, KeyboardInterrupt])
def test_exit__exception_leaves_nothing(tmp_path, error):
    with pytest.raises(error):
        fail_with(error, tmp_path / "a" / "out")
    assert list(tmp_path.iterdir()) == []


def test_exit__exception_leaves_the_old_run(tmp_path):
    write(tmp_path, {"t.csv": "old"})
    before = content(tmp_path)
    with pytest.raises(StopError):
        fail_with(StopError, tmp_path, overwrite=True)
    assert content(tmp_path) == before


def test_exit__failure_while_replacing_leaves_the_old_run(tmp_path, monkeypatch):
    write(tmp_path, {"a.csv": "old", "b.csv": "old", "c.csv": "old"})
    before = content(tmp_path)
    rename = Path.rename

    def fail_on_b(self, target):
        if Path(target) == tmp_path / "b.csv" and self.read_text() == "new":
            raise OSError(errno.EIO, "Input/output error")
        return rename(self, target)

    monkeypatch.setattr(Path, "rename", fail_on_b)
    with pytest.raises(OutputError, match="Input/output error"):
        write(tmp_path, {"a.csv": "new", "b.csv": "new"}, overwrite=True)
    assert content(tmp_path) == before


def test_write__full_disk(tmp_path, monkeypatch):
    def fail(self, data):
        raise OSError(errno.ENOSPC, "No space left on device")

    monkeypatch.setattr(Path, "write_bytes", fail)
    with pytest.raises(OutputError, match=r"out/t\.csv: cannot be written: No space left"):
        write(tmp_path / "out", {"t.csv": "1"})
    assert list(tmp_path.iterdir()) == []


def test_enter__existing_run(tmp_path):
    write(tmp_path / "out", {"t.csv": "1"})
    with pytest.raises(OutputError, match="already holds a run; use --overwrite to replace it, or"):
        write(tmp_path / "out", {"t.csv": "2"})
    assert content(tmp_path)["out/t.csv"] == "1"


def test_enter__folder_that_is_no_run(tmp_path):
    (tmp_path / "notes.txt").write_text("mine")
    with pytest.raises(OutputError, match="is not empty and holds no run"):
        write(tmp_path, {})


def test_overwrite__replaces_the_old_files_and_keeps_the_users(tmp_path):
    write(tmp_path, {"t.csv": "old", "gone.csv": "old", "sub/gone.csv": "old"})
    (tmp_path / "notes.txt").write_text("mine")
    (tmp_path / "mine").mkdir()
    (tmp_path / "mine" / "t.csv").write_text("mine")
    write(tmp_path, {"t.csv": "new"}, overwrite=True)
    after = content(tmp_path)
    assert sorted(after) == ["mine/t.csv", "notes.txt", "summary.json", "t.csv"]
    assert (after["t.csv"], after["mine/t.csv"], after["notes.txt"]) == ("new", "mine", "mine")
    assert not (tmp_path / "sub").exists()


def test_overwrite__keeps_a_users_file_in_a_subfolder_of_the_run(tmp_path):
    write(tmp_path, {"sub/gone.csv": "old"})
    (tmp_path / "sub" / "notes.txt").write_text("mine")
    write(tmp_path, {"t.csv": "new"}, overwrite=True)
    assert sorted(content(tmp_path)) == ["sub/notes.txt", "summary.json", "t.csv"]


def test_overwrite__users_file_in_the_way(tmp_path):
    (tmp_path / "t.csv").write_text("mine")
    with pytest.raises(OutputError, match=r"t\.csv is in the way"):
        OutputFolder.check(tmp_path, overwrite=True, names=["t.csv"])
    with pytest.raises(OutputError, match=r"t\.csv is in the way"):
        write(tmp_path, {"t.csv": "new"}, overwrite=True)
    assert content(tmp_path) == {"t.csv": "mine"}


def test_overwrite__folder_that_is_no_run_gets_the_files(tmp_path):
    (tmp_path / "notes.txt").write_text("mine")
    write(tmp_path, {"t.csv": "new"}, overwrite=True)
    assert sorted(content(tmp_path)) == ["notes.txt", "summary.json", "t.csv"]


def test_overwrite__hostile_manifest_deletes_nothing_outside(tmp_path):
    outside = tmp_path / "outside"
    outside.mkdir()
    (outside / "precious.txt").write_text("mine")
    run = tmp_path / "run"
    run.mkdir()
    (run / "link").symlink_to(outside, target_is_directory=True)
    (run / "folder").mkdir()
    names = [
        str(outside / "precious.txt"),
        "../outside/precious.txt",
        "link/precious.txt",
        "link/../outside/precious.txt",
        "folder",
        "a\0b",
        "",
        ".",
        "..",
        7,
        None,
        ["x"],
    ]
    (run / "summary.json").write_text(json.dumps({"files": names}))
    write(run, {"t.csv": "new"}, overwrite=True)
    assert (outside / "precious.txt").read_text() == "mine"
    assert (run / "folder").is_dir()
    assert (run / "link").is_symlink()


@pytest.mark.parametrize("manifest", ["", "[]", "7", '{"files": 7}', "{", "[" * 100_000, "\0"])
def test_overwrite__summary_that_is_no_manifest_is_the_users(tmp_path, manifest):
    (tmp_path / "summary.json").write_text(manifest)
    with pytest.raises(OutputError, match="holds no run"):
        OutputFolder.check(tmp_path)
    with pytest.raises(OutputError, match=r"summary\.json is in the way"):
        write(tmp_path, {}, overwrite=True)
    assert (tmp_path / "summary.json").read_text() == manifest


def test_check__leaves_no_trace(tmp_path):
    OutputFolder.check(tmp_path / "a" / "b")
    OutputFolder.check(tmp_path)
    assert list(tmp_path.iterdir()) == []


def test_check__path_is_a_file(tmp_path):
    (tmp_path / "out").write_text("mine")
    with pytest.raises(OutputError, match="is a file, not a folder"):
        OutputFolder.check(tmp_path / "out", overwrite=True)


def test_check__path_below_a_file(tmp_path):
    (tmp_path / "file").write_text("mine")
    with pytest.raises(OutputError, match=r"file is a file, so nothing can be written below it"):
        OutputFolder.check(tmp_path / "file" / "a" / "b")


@pytest.mark.skipif(
    not hasattr(os, "geteuid") or os.geteuid() == 0, reason="nothing is read-only to root"
)
def test_check__parent_that_is_read_only(tmp_path):
    tmp_path.chmod(0o500)
    with pytest.raises(OutputError, match="out: cannot be written: Permission denied"):
        OutputFolder.check(tmp_path / "out")
    tmp_path.chmod(0o700)


def test_check__parent_that_refuses(tmp_path, monkeypatch):
    def refuse(self, *args, **kwargs):
        raise PermissionError(errno.EACCES, "Permission denied")

    monkeypatch.setattr(Path, "mkdir", refuse)
    with pytest.raises(OutputError, match="out: cannot be written: Permission denied"):
        OutputFolder.check(tmp_path / "out")


@pytest.mark.parametrize("name", ["x" * 300, "a\0b"])
def test_check__name_that_no_file_system_takes(tmp_path, name):
    with pytest.raises(OutputError, match="cannot be"):
        OutputFolder.check(tmp_path / name)


def test_check__loop_of_links(tmp_path):
    (tmp_path / "a").symlink_to("b")
    (tmp_path / "b").symlink_to("a")
    with pytest.raises(OutputError):
        OutputFolder.check(tmp_path / "a")


def test_check__what_a_killed_run_left_does_not_count(tmp_path):
    (tmp_path / ".beamseg-0123456789ab").mkdir()
    OutputFolder.check(tmp_path)


def test_encoded__undecodable_bytes_of_a_file_name():
    assert encoded("flight\udcff") == b"flight\\udcff"
    assert encoded(b"\xff") == b"\xff"


def test_partial_path__stands_beside(tmp_path, monkeypatch):
    assert partial_path(Path("a/out")) == Path("a/out.partial")
    (tmp_path / "here").mkdir()
    monkeypatch.chdir(tmp_path / "here")
    assert partial_path(Path()) == tmp_path.resolve() / "here.partial"
