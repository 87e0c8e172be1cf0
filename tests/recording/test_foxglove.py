"""Foxglove's messages in MCAP, in protobuf and in JSON, with every compression."""

from __future__ import annotations

import numpy as np
import pytest
from mcap.writer import CompressionType

from beamseg_batch.config import RunConfig
from beamseg_batch.model import Scan
from beamseg_batch.recording import open_flight, open_recording
from tests.foxglove import cloud, pose_content, transform, write
from tests.recording.conftest import some_poses
from tests.recordings import START_NS


def clouds(count=3):
    rng = np.random.default_rng(4)
    return [
        (START_NS + k * 10**8, rng.uniform(0.2, 2.0, size=(50, 3)).astype(np.float32))
        for k in range(count)
    ]


@pytest.mark.parametrize("compression", list(CompressionType))
@pytest.mark.parametrize("encoding", ["protobuf", "json"])
@pytest.mark.parametrize(
    "msgtype", ["PoseInFrame", "PosesInFrame", "FrameTransform", "FrameTransforms"]
)
def test_scans__of_foxglove(tmp_path, encoding, msgtype, compression):
    messages = [cloud(*entry) for entry in clouds()]
    messages += [
        ("/pose", stamp, f"foxglove.{msgtype}", pose_content(msgtype, stamp, *rest))
        for stamp, *rest in some_poses()
    ]
    static = {"transforms": [transform(START_NS, (0.1, 0, 0), (0, 0, 0, 1), "base_link", "tof")]}
    messages.append(("/tf_static", START_NS, "foxglove.FrameTransforms", static))
    path = write(tmp_path / "flight.mcap", encoding, compression, messages)
    flight = open_flight(open_recording(path), RunConfig())
    scans = [scan for scan in flight.scans() if isinstance(scan, Scan)]
    assert [scan.stamp_ns for scan in scans] == [stamp for stamp, _ in clouds()]
    for scan, (_, points) in zip(scans, clouds(), strict=True):
        np.testing.assert_array_equal(scan.points, points)
    np.testing.assert_allclose(flight.trajectory.positions, [p for _, p, _ in some_poses()])
    np.testing.assert_allclose(flight.extrinsic.T_body_sensor.translation, [0.1, 0.0, 0.0])
    assert (flight.roles.world, flight.roles.body) == ("map", "base_link")
