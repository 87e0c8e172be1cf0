"""Cut the samples out of the flight of the simulated test arena.

    make samples FLIGHT=path/to/webots_tests

Messages are copied byte for byte, so that a sample is a true part of the flight.
"""

from __future__ import annotations

import csv
import sys
from pathlib import Path

from mcap.reader import make_reader
from mcap.writer import CompressionType
from mcap.writer import Writer as McapWriter
from rosbags.rosbag1 import Reader as BagReader
from rosbags.rosbag1 import Writer as BagWriter

SECONDS = 20
HERE = Path(__file__).parent
TRUE_COLUMNS = ("id", "x1", "y1", "z1", "x2", "y2", "z2", "radius", "shape")


def cut_mcap(source: Path, target: Path) -> None:
    """Copy the first seconds of an MCAP file.

    Parameters
    ----------
    source, target : Path
    """
    with source.open("rb") as stream, target.open("wb") as out:
        reader = make_reader(stream)
        writer = McapWriter(out, compression=CompressionType.ZSTD, chunk_size=1 << 20)
        header = reader.get_header()
        writer.start(profile=header.profile, library="beamseg-batch samples")
        schemas: dict[int, int] = {}
        channels: dict[int, int] = {}
        end_ns = None
        for schema, channel, message in reader.iter_messages():
            end_ns = end_ns or message.log_time + SECONDS * 10**9
            if message.log_time >= end_ns:
                break
            assert schema is not None
            if schema.id not in schemas:
                schemas[schema.id] = writer.register_schema(
                    schema.name, schema.encoding, schema.data
                )
            if channel.id not in channels:
                channels[channel.id] = writer.register_channel(
                    channel.topic, channel.message_encoding, schemas[schema.id], channel.metadata
                )
            writer.add_message(
                channel_id=channels[channel.id],
                log_time=message.log_time,
                publish_time=message.publish_time,
                sequence=message.sequence,
                data=message.data,
            )
        writer.finish()


def cut_bag(source: Path, target: Path) -> None:
    """Copy the first seconds of a ROS 1 bag.

    Parameters
    ----------
    source, target : Path
    """
    target.unlink(missing_ok=True)
    writer = BagWriter(target)
    writer.set_compression(BagWriter.CompressionFormat.LZ4)
    with BagReader(source) as reader, writer:
        connections = {
            connection.id: writer.add_connection(
                connection.topic,
                connection.msgtype,
                msgdef=connection.msgdef.data,
                md5sum=connection.digest,
            )
            for connection in reader.connections
        }
        end_ns = reader.start_time + SECONDS * 10**9
        for connection, stamp_ns, raw in reader.messages(stop=end_ns):
            writer.write(connections[connection.id], stamp_ns, raw)


def cut_truth(source: Path, target: Path) -> None:
    """Copy the true ends of the members; what a cut flight saw of them is another matter.

    Parameters
    ----------
    source, target : Path
    """
    with source.open(newline="") as stream, target.open("w", newline="") as out:
        writer = csv.DictWriter(out, TRUE_COLUMNS, extrasaction="ignore", lineterminator="\n")
        writer.writeheader()
        writer.writerows(csv.DictReader(stream))


def main(flight: Path) -> None:
    """Write all samples.

    Parameters
    ----------
    flight : Path
        Folder with `flight.mcap`, `flight.bag`, `truth.csv` and `truth_intersections.csv`.
    """
    cut_mcap(flight / "flight.mcap", HERE / "arena.mcap")
    cut_bag(flight / "flight.bag", HERE / "arena.bag")
    cut_truth(flight / "truth.csv", HERE / "arena_truth.csv")
    joints = (flight / "truth_intersections.csv").read_text(encoding="utf-8")
    (HERE / "arena_truth_intersections.csv").write_text(joints, encoding="utf-8")


if __name__ == "__main__":
    if len(sys.argv) != 2:
        sys.exit("usage: make_samples.py FLIGHT, the folder of the flight to cut")
    main(Path(sys.argv[1]))
