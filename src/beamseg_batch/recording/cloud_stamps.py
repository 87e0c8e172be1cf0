"""The stamps of the clouds, without their points."""

from __future__ import annotations

from contextlib import suppress
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from beamseg_batch.config import RunConfig
from beamseg_batch.recording.clouds import read_header
from beamseg_batch.recording.codec import UndecodableMessageError
from beamseg_batch.recording.matching import seconds_to_ns, within_int64
from beamseg_batch.recording.selection import Selection
from beamseg_batch.recording.source import Recording, TopicInfo
from beamseg_batch.recording.templates import (
    HEADER_BYTES,
    HEADER_FIRST,
    header_stamp_ns,
    is_templated,
)

__all__ = ["CloudStamps", "cloud_stamp_ns", "read_cloud_stamps"]


@dataclass(frozen=True, eq=False)
class CloudStamps:
    """Stamps of the selected clouds in order of log time.

    Attributes
    ----------
    indices : (N,) int64
        Positions among all clouds of the topic.
    used_ns : (N,) int64
        Stamps that are matched with poses.
    headers_ns, log_times_ns : list of int
        What these are chosen from.
    """

    indices: NDArray[np.int64]
    used_ns: NDArray[np.int64]
    headers_ns: list[int]
    log_times_ns: list[int]


def cloud_stamp_ns(stamp_ns: int, log_time_ns: int, config: RunConfig) -> int:
    """Stamp of a cloud, of its header or of the log, plus the offset.

    Parameters
    ----------
    stamp_ns : int
        Of the header; the log time stands in for it when that is zero.
    log_time_ns : int
    config : RunConfig
        Whose ``recording.time_source`` chooses and ``recording.time_offset_s`` is added.

    Returns
    -------
    int, nanoseconds
    """
    chosen = log_time_ns if config.recording.time_source == "log" else stamp_ns or log_time_ns
    return within_int64(chosen + seconds_to_ns(config.recording.time_offset_s))


def read_cloud_stamps(recording: Recording, topic: TopicInfo, config: RunConfig) -> CloudStamps:
    """Read the stamps of the selected clouds: out of the bytes where their place is known.

    Parameters
    ----------
    recording : Recording
    topic : TopicInfo
        Of one of the types of clouds.
    config : RunConfig

    Returns
    -------
    CloudStamps
        Without those that cannot be decoded.

    Raises
    ------
    RecordingError
        If the file cannot be read any further.
    """
    indices: list[int] = []
    used: list[int] = []
    headers: list[int] = []
    logged: list[int] = []
    is_known = topic.msgtype in HEADER_FIRST
    encoding = recording.encoding_of(topic.msgtype)
    selection = Selection.of(config.recording, recording)
    for index, raw in selection.messages(recording, topic):
        with suppress(UndecodableMessageError):
            if is_known and is_templated(raw.data, encoding) and len(raw.data) >= HEADER_BYTES:
                stamp_ns = header_stamp_ns(raw.data)
            else:
                stamp_ns = recording.read(raw, read_header).stamp_ns
            indices.append(index)
            headers.append(stamp_ns)
            logged.append(within_int64(raw.log_time_ns))
            used.append(cloud_stamp_ns(stamp_ns, raw.log_time_ns, config))
    return CloudStamps(np.array(indices, np.int64), np.array(used, np.int64), headers, logged)
