"""Cloud messages of any type -> clouds."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from functools import partial
from typing import Any

import numpy as np

from beamseg_batch.config import SensorConfig
from beamseg_batch.recording.axes import turned_ahead
from beamseg_batch.recording.clouds import Cloud, CloudMessage, Confidence, read_cloud
from beamseg_batch.recording.containers import RawMessage
from beamseg_batch.recording.depth import IMAGE, DepthCamera, find_camera
from beamseg_batch.recording.other_clouds import CLOUD_READERS
from beamseg_batch.recording.source import Recording, TopicInfo
from beamseg_batch.recording.templates import CloudTemplate, cloud_template

__all__ = ["CloudReader"]


class CloudReader:
    """Reads the clouds of a topic; one laid out like an earlier one is not decoded again.

    Parameters
    ----------
    recording : Recording
    topic : TopicInfo
        Of one of the types of clouds.
    config : SensorConfig
    z_forward : bool, optional
        Whether the clouds are to be turned from optical axes to x forward.

    Raises
    ------
    RecordingError
        If the topic holds images, and their camera cannot be found.
    """

    def __init__(
        self, recording: Recording, topic: TopicInfo, config: SensorConfig, z_forward: bool = False
    ) -> None:
        self._recording = recording
        self._z_forward = z_forward
        self._template: CloudTemplate | None = None
        self._confidence = (
            None
            if config.min_confidence is None
            else Confidence(config.confidence_fields, config.min_confidence)
        )
        self.camera: DepthCamera | None = None
        self._decode: Callable[[Any], Cloud]
        if topic.msgtype == IMAGE:
            self.camera = find_camera(recording, topic)
            self._decode = self.camera.read
        else:
            read = CLOUD_READERS[topic.msgtype]
            self._decode = lambda message: read(message, self._confidence)
        self._is_templated = CLOUD_READERS.get(topic.msgtype) is read_cloud

    def read(self, raw: RawMessage) -> Cloud:
        """Read a cloud.

        Parameters
        ----------
        raw : RawMessage

        Returns
        -------
        Cloud

        Raises
        ------
        UndecodableMessageError
            If the bytes do not fit the type.
        """
        cloud = self._template.read(raw.data) if self._template else None
        if cloud is None:
            cloud = self._recording.read(raw, partial(self._decoded, raw))
        if not self._z_forward or len(cloud.points) == 0:
            return cloud
        return replace(cloud, points=turned_ahead(cloud.points))

    def _decoded(self, raw: RawMessage, message: CloudMessage) -> Cloud:
        if self._is_templated:
            encoding = self._recording.encoding_of(raw.msgtype)
            self._template = cloud_template(raw.data, message, encoding, self._confidence)
        with np.errstate(invalid="ignore"):  # a NaN is no error
            return self._decode(message)
