"""Files -> scans: recordings of any supported kind, read as clouds paired with poses.

>>> from beamseg_batch.config import load_config
>>> from beamseg_batch.recording import open_flight, open_recording
>>> flight = open_flight(open_recording("flight.mcap"), load_config())  # doctest: +SKIP
>>> for scan in flight.scans():  # doctest: +SKIP
...     print(scan)
"""

from __future__ import annotations

from beamseg_batch.recording.flight import Flight, open_flight
from beamseg_batch.recording.inspection import RecordingSummary, inspect_recording
from beamseg_batch.recording.source import Recording, TopicInfo, open_recording

__all__ = [
    "Flight",
    "Recording",
    "RecordingSummary",
    "TopicInfo",
    "inspect_recording",
    "open_flight",
    "open_recording",
]
