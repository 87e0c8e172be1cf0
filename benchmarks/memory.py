"""Peak memory of `beamseg run` on a short and on a long recording of the same flight.

python -m benchmarks.memory                    # 1,000 and 20,000 scans, MCAP and bag
python -m benchmarks.memory --scans 500 5000 --profiles report

The sample flight is flown round after round, its stamps moved on: a recording of any length
with as many poses to a scan as a drone has, and with beams that stay as few as they are, so
that whatever grows, grows with the recording.
"""

from __future__ import annotations

import argparse
import subprocess
import sys
import tempfile
from collections.abc import Iterator
from pathlib import Path
from struct import Struct

from beamseg_batch.recording import Recording, open_recording
from beamseg_batch.recording.codec import CDR, ROS1, default_typestore
from beamseg_batch.recording.container import RawMessage
from beamseg_batch.recording.templates import STAMP_AT, header_stamp_ns

__all__ = ["peak_mb", "write_rounds"]

SAMPLES = Path(__file__).parents[1] / "data/samples"
EXTRINSIC = "0.071,0.011,0.04"  # of the sample's camera
CLOUDS = "/tof_pc"
CHUNK_BYTES = 768 << 10  # what recorders take
SETTINGS = {"report": (), "precise": ("--set", "refinement.passes=2")}
"""What is measured: precise with fewer passes than it has, which cost time but no memory."""

_STAMP = Struct("<iI")
_PEAK_OF = """
import resource, subprocess, sys
subprocess.run(sys.argv[1:], check=True, stdout=subprocess.DEVNULL)
print(resource.getrusage(resource.RUSAGE_CHILDREN).ru_maxrss)
"""


def peak_mb(arguments: list[str]) -> float:
    """Peak resident memory of a command, asked of a process that started nothing else.

    Parameters
    ----------
    arguments : list of str
        As they follow `beamseg`.

    Returns
    -------
    float, MB
    """
    done = subprocess.run(
        [sys.executable, "-c", _PEAK_OF, sys.executable, "-m", "beamseg_batch", *arguments],
        check=True,
        stdout=subprocess.PIPE,
        text=True,
    )
    return int(done.stdout.split()[-1]) / 1024


def write_rounds(source: Path, target: Path, n_scans: int) -> None:
    """Write a flight round after round, until there are enough scans.

    Parameters
    ----------
    source : Path
        A bag, or an MCAP file of ROS 2, whose messages all begin with a header.
    target : Path
        File of the same kind.
    n_scans : int
    """
    recording = open_recording(source)
    write = _write_bag if source.suffix == ".bag" else _write_mcap
    write(recording, target, _rounds(recording, n_scans))


def _rounds(recording: Recording, n_scans: int) -> Iterator[RawMessage]:
    topics = [topic.name for topic in recording.topics]
    period_ns = recording.end_ns - recording.start_ns + 8_000_000
    moved_ns, left = 0, n_scans
    while left:
        for raw in recording.messages(topics):
            stamp = _STAMP.pack(*divmod(header_stamp_ns(raw.data) + moved_ns, 10**9))
            data = raw.data[:STAMP_AT] + stamp + raw.data[STAMP_AT + len(stamp) :]
            yield raw._replace(log_time_ns=raw.log_time_ns + moved_ns, data=data)
            left -= raw.topic == CLOUDS
            if not left:
                return
        moved_ns += period_ns


def _write_mcap(recording: Recording, target: Path, messages: Iterator[RawMessage]) -> None:
    from mcap.writer import Writer

    store = default_typestore(CDR)
    with target.open("wb") as stream:
        writer = Writer(stream, chunk_size=CHUNK_BYTES)
        writer.start(profile="ros2")
        channels = {}
        for topic in recording.topics:
            text = store.generate_msgdef(topic.msgtype, ros_version=2)[0].encode()
            schema = writer.register_schema(topic.msgtype, "ros2msg", text)
            channels[topic.name] = writer.register_channel(topic.name, CDR, schema)
        for raw in messages:
            writer.add_message(channels[raw.topic], raw.log_time_ns, raw.data, raw.log_time_ns)
        writer.finish()


def _write_bag(recording: Recording, target: Path, messages: Iterator[RawMessage]) -> None:
    from rosbags.rosbag1 import Writer

    store = default_typestore(ROS1)
    writer = Writer(target)
    writer.set_compression(Writer.CompressionFormat.LZ4)
    with writer:
        connections = {
            topic.name: writer.add_connection(topic.name, topic.msgtype, typestore=store)
            for topic in recording.topics
        }
        for raw in messages:
            writer.write(connections[raw.topic], raw.log_time_ns, raw.data)


def main() -> None:
    """Write recordings, run on them, print a table."""
    parser = argparse.ArgumentParser(prog="python -m benchmarks.memory", description=__doc__)
    parser.add_argument("--scans", type=int, nargs="+", default=[1_000, 20_000])
    parser.add_argument("--profiles", nargs="+", choices=SETTINGS, default=list(SETTINGS))
    parser.add_argument("--kinds", nargs="+", choices=("mcap", "bag"), default=["mcap", "bag"])
    parser.add_argument("--folder", type=Path, help="keep the recordings here, and use them again")
    asked = parser.parse_args()
    print(f"{'kind':6}{'profile':10}{'scans':>8}{'messages':>10}{'file':>10}{'peak':>10}")
    with tempfile.TemporaryDirectory() as made:
        folder = asked.folder or Path(made)
        for kind in asked.kinds:
            for n_scans in asked.scans:
                path = folder / f"arena-{n_scans}.{kind}"
                if not path.exists():
                    write_rounds(SAMPLES / f"arena.{kind}", path, n_scans)
                for profile in asked.profiles:
                    print(_row(path, kind, profile, n_scans, Path(made)), flush=True)


def _row(path: Path, kind: str, profile: str, n_scans: int, folder: Path) -> str:
    count = sum(topic.count for topic in open_recording(path).topics)
    run = ["run", str(path), "--profile", profile, "--extrinsic", EXTRINSIC]
    run += [*SETTINGS[profile], "-q", "--overwrite", "-o", str(folder / "out")]
    size_mb = path.stat().st_size / 1e6
    return f"{kind:6}{profile:10}{n_scans:8}{count:10}{size_mb:7.0f} MB{peak_mb(run):7.0f} MB"


if __name__ == "__main__":
    main()
