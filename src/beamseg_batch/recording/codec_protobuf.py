"""Protobuf messages -> plain objects, by the descriptors that an MCAP schema carries."""

from __future__ import annotations

from collections.abc import Callable
from types import SimpleNamespace
from typing import Any

__all__ = ["protobuf_decoder"]

_TIMES = ("google.protobuf.Timestamp", "google.protobuf.Duration")


def protobuf_decoder(name: str, descriptors: bytes) -> Callable[[bytes], object]:
    """Make a decoder of one message type.

    Parameters
    ----------
    name : str
        Full name of the type, such as ``foxglove.PointCloud``.
    descriptors : bytes
        A serialised ``google.protobuf.FileDescriptorSet`` with the type and all that it
        is made of.

    Returns
    -------
    callable
        From the bytes of a message to its object: a field is an attribute of that name,
        fields that were not written have their default, a repeated field is a list,
        bytes are bytes, and a time or duration has ``sec`` and ``nsec``.
    """
    from google.protobuf.descriptor_pb2 import FileDescriptorSet
    from google.protobuf.descriptor_pool import DescriptorPool
    from google.protobuf.message_factory import GetMessageClass

    files = {file.name: file for file in FileDescriptorSet.FromString(descriptors).file}
    pool = DescriptorPool()  # of its own: two recordings may define one name differently

    def add(file: Any) -> None:
        """Add a file after those it depends on, whatever their order in the set."""
        for dependency in file.dependency:
            if dependency in files:
                add(files.pop(dependency))
        pool.Add(file)

    while files:
        add(files.popitem()[1])
    message_class = GetMessageClass(pool.FindMessageTypeByName(name))
    return lambda raw: _plain(message_class.FromString(raw))


def _plain(message: Any) -> SimpleNamespace:
    descriptor = message.DESCRIPTOR
    if descriptor.full_name in _TIMES:
        return SimpleNamespace(sec=message.seconds, nsec=message.nanos)
    return SimpleNamespace(
        **{field.name: _value(getattr(message, field.name), field) for field in descriptor.fields}
    )


def _value(value: Any, field: Any) -> Any:
    if field.message_type is None:
        return value if isinstance(value, str | bytes | bool | int | float) else list(value)
    if field.message_type.GetOptions().map_entry:
        return dict(value)
    if hasattr(value, "DESCRIPTOR"):
        return _plain(value)
    return [_plain(item) for item in value]
