"""A flight is written whole or not at all, and nothing of others is touched."""

from __future__ import annotations

import os
from pathlib import Path

import pytest

from beamseg_batch.errors import OutputError
from beamseg_batch.simulation.output import TRUTH_FILES, FlightOutput, write_files

NEW, OLD = "#ROSBAG new", "#ROSBAG old"


def write(output, content=NEW):
    with output.staged() as (recording, truth):
        recording.write_text(content)
        write_files(truth, {name: [content] for name in TRUTH_FILES})


def names(folder):
    return sorted(str(path.relative_to(folder)) for path in folder.rglob("*"))


ALL = sorted(["f.mcap", "truth", *(f"truth/{name}" for name in TRUTH_FILES)])


def test_staged__writes_recording_and_truth(tmp_path):
    write(FlightOutput(tmp_path / "new" / "sim" / "f.mcap"))
    assert names(tmp_path / "new" / "sim") == ALL
    assert (tmp_path / "new" / "sim" / "f.mcap").read_text() == NEW


def test_staged__error_leaves_nothing(tmp_path):
    with pytest.raises(RuntimeError), FlightOutput(tmp_path / "a" / "b" / "f.mcap").staged() as it:
        it[0].write_text("half")
        raise RuntimeError
    assert names(tmp_path) == []


def test_staged__error_leaves_what_was_there(tmp_path):
    output = FlightOutput(tmp_path / "f.mcap", overwrite=True)
    write(output, OLD)
    with pytest.raises(KeyboardInterrupt), output.staged() as (recording, _):
        recording.write_text("half")
        raise KeyboardInterrupt
    assert names(tmp_path) == ALL
    assert (tmp_path / "f.mcap").read_text() == OLD


def test_staged__missing_file_brings_the_old_ones_back(tmp_path):
    """The last move fails: what had been moved is undone."""
    output = FlightOutput(tmp_path / "f.mcap", overwrite=True)
    write(output, OLD)
    with pytest.raises(OutputError, match="cannot be written"), output.staged() as it:
        it[0].write_text(NEW)
        write_files(it[1], {name: [NEW] for name in TRUTH_FILES[:-1]})
    assert names(tmp_path) == ALL
    assert {(tmp_path / name).read_text() for name in ALL if name != "truth"} == {OLD}


def test_staged__overwrites_only_when_asked(tmp_path):
    write(FlightOutput(tmp_path / "f.mcap"), OLD)
    with pytest.raises(OutputError, match=r"f\.mcap exists already; use --overwrite"):
        write(FlightOutput(tmp_path / "f.mcap"))
    with pytest.raises(OutputError, match="truth exists already; use --overwrite"):
        write(FlightOutput(tmp_path / "other.mcap"))
    write(FlightOutput(tmp_path / "f.mcap", overwrite=True))
    assert names(tmp_path) == ALL
    assert (tmp_path / "truth" / "truth.csv").read_text() == NEW


def test_staged__leaves_the_files_of_others(tmp_path):
    (tmp_path / "truth").mkdir()
    (tmp_path / "truth" / "notes.txt").write_text("mine")
    write(FlightOutput(tmp_path / "f.mcap", overwrite=True))
    assert (tmp_path / "truth" / "notes.txt").read_text() == "mine"


def test_check__folder_that_is_no_bag(tmp_path):
    output = FlightOutput(tmp_path / "photos", overwrite=True)
    output.recording.mkdir()
    with pytest.raises(OutputError, match="photos is no recording: it stays as it is"):
        output.check()
    (output.recording / "metadata.yaml").write_text("")
    output.check()


@pytest.mark.parametrize("start", [b"members:", b"\x89PNG\r\n"])
def test_check__file_that_is_no_recording(tmp_path, start):
    """Such as the world itself: it must not be replaced."""
    (tmp_path / "world.yaml").write_bytes(start)
    output = FlightOutput(tmp_path / "world.yaml", overwrite=True)
    with pytest.raises(OutputError, match=r"world\.yaml is no recording: it stays as it is"):
        write(output)
    assert output.recording.read_bytes() == start


@pytest.mark.skipif(not Path("/dev/zero").exists(), reason="the system has no such device")
def test_check__device():
    with pytest.raises(OutputError, match="/dev/zero is no recording: it stays as it is"):
        FlightOutput(Path("/dev/zero"), overwrite=True).check()


@pytest.mark.parametrize("name", ["old", "recording"])
def test_staged__whatever_the_name(tmp_path, name):
    write(FlightOutput(tmp_path / name))
    assert names(tmp_path) == sorted([name, *ALL[1:]])


def test_check__name_of_the_truth(tmp_path):
    with pytest.raises(OutputError, match="truth is where the truth goes; choose another name"):
        FlightOutput(tmp_path / "truth").check()


def test_check__truth_that_is_a_file(tmp_path):
    (tmp_path / "truth").write_text("")
    with pytest.raises(OutputError, match="is a file, so the truth cannot be written into it"):
        FlightOutput(tmp_path / "f.mcap", overwrite=True).check()


def test_check__no_name():
    with pytest.raises(OutputError, match="names no file"):
        FlightOutput(Path("/")).check()


@pytest.mark.skipif(not hasattr(os, "getuid") or os.getuid() == 0, reason="root may write anywhere")
def test_staged__folder_that_cannot_be_written(tmp_path):
    tmp_path.chmod(0o500)
    with pytest.raises(OutputError, match="cannot be written: Permission denied"):
        write(FlightOutput(tmp_path / "f.mcap"))
    tmp_path.chmod(0o700)


def test_staged__below_a_file(tmp_path):
    (tmp_path / "file").write_text("")
    with pytest.raises(OutputError, match="cannot be written: Not a directory"):
        write(FlightOutput(tmp_path / "file" / "f.mcap"))
