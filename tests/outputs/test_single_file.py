"""One file that is whole or absent."""

from __future__ import annotations

import pytest

from beamseg_batch.errors import OutputError
from beamseg_batch.outputs.single_file import check_file, staged_file


def test_staged_file__appears_when_it_is_finished(tmp_path):
    path = tmp_path / "new" / "deep" / "file.txt"
    with staged_file(path) as staged:
        assert staged.name == "file.txt"
        staged.write_text("whole")
        assert not path.exists()
    assert path.read_text() == "whole"
    assert list(path.parent.iterdir()) == [path]


def test_staged_file__an_error_leaves_what_was_there(tmp_path):
    path = tmp_path / "file.txt"
    path.write_text("old")
    with pytest.raises(KeyError), staged_file(path, overwrite=True) as staged:
        staged.write_text("half")
        raise KeyError("something else")
    assert path.read_text() == "old"
    assert list(tmp_path.iterdir()) == [path]


def test_staged_file__an_error_leaves_no_new_folder(tmp_path):
    with pytest.raises(KeyError), staged_file(tmp_path / "new" / "file.txt"):
        raise KeyError("something else")
    assert list(tmp_path.iterdir()) == []


def test_staged_file__nothing_written_is_an_error(tmp_path):
    with pytest.raises(OutputError, match="cannot be written"), staged_file(tmp_path / "f.txt"):
        pass


def test_check_file__refuses_what_is_in_the_way(tmp_path):
    (tmp_path / "file").write_text("mine")
    with pytest.raises(OutputError, match="exists already; use --overwrite"):
        check_file(tmp_path / "file")
    check_file(tmp_path / "file", overwrite=True)
    with pytest.raises(OutputError, match="is a folder, not a file"):
        check_file(tmp_path, overwrite=True)
    with pytest.raises(OutputError, match="is a file, so nothing can be written below it"):
        check_file(tmp_path / "file" / "deep" / "other.txt")


def test_check_file__leaves_no_trace(tmp_path):
    check_file(tmp_path / "new" / "file.txt")
    assert list(tmp_path.iterdir()) == []
