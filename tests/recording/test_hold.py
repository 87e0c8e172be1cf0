"""Messages kept in memory for later passes."""

from __future__ import annotations

import pytest

from beamseg_batch.errors import RecordingError
from beamseg_batch.recording import open_recording, source
from tests.recording.conftest import some_clouds, some_poses
from tests.recordings import write_recording

TOPICS = ["/tof_pc", "/mavros/local_position/pose"]


@pytest.fixture(params=["bag", "mcap"])
def recording(tmp_path, request):
    return open_recording(write_recording(tmp_path, request.param, some_clouds(), some_poses()))


def test_hold__gives_the_same_messages_without_the_file(recording):
    streamed = list(recording.messages(TOPICS))
    one = list(recording.messages(TOPICS[:1]))
    recording.hold(TOPICS)
    recording.paths[0].unlink()
    assert list(recording.messages(TOPICS)) == streamed
    assert list(recording.messages(TOPICS[:1])) == one
    with pytest.raises(RecordingError):
        list(recording.messages(["/tf_static"]))


def test_hold__keeps_nothing_that_is_too_large(recording, monkeypatch):
    size = sum(len(raw.data) for raw in recording.messages(TOPICS))
    monkeypatch.setattr(source, "_MOST_HELD_BYTES", max(size - 1, 0))
    recording.hold(TOPICS)
    recording.paths[0].unlink()
    with pytest.raises(RecordingError):
        list(recording.messages(TOPICS))


def test_hold__damage_is_noted_once(recording):
    path = recording.paths[0]
    whole = path.read_bytes()
    path.write_bytes(whole[: len(whole) // 2])
    for _ in range(2):
        list(recording.messages(TOPICS))
        recording.hold(TOPICS)
    (note,) = recording.damage_notes
    assert note.startswith(f"{path}: is damaged, what is whole is used: byte ")
