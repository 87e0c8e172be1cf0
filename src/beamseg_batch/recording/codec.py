"""Raw messages -> message objects, by the definitions that a recording carries.

This module decides which definition is used. A recording's own comes first, since it
describes the bytes at hand. Every message type gets a decoder of its own, built when the
first message of that type is decoded: a definition that is broken, or that contradicts
another, then hurts its own type only.

What a message object looks like: every field is an attribute of the name that the
definition gives it, nested messages likewise, repeated fields are sequences.

* ROS 1 and ROS 2 (named ``package/msg/Type``): as rosbags makes them. Times have ``sec``
  and ``nanosec``, arrays of numbers are read-only numpy arrays.
* Protobuf and JSON (named ``foxglove.PointCloud`` and so on): times have ``sec`` and
  ``nsec``, so that a cloud's stamp is ``cloud.timestamp.sec`` and ``.nsec``; ``data`` is
  bytes, in JSON too; repeated fields are lists; an enumeration such as
  ``cloud.fields[0].type`` is its number.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from functools import lru_cache
from typing import TYPE_CHECKING, Any, TypeVar

from beamseg_batch.errors import RecordingError

if TYPE_CHECKING:
    from rosbags.typesys.store import Typestore

__all__ = [
    "CDR",
    "JSON",
    "PROTOBUF",
    "ROS1",
    "Definition",
    "MessageCodec",
    "UndecodableMessageError",
    "default_typestore",
    "ros2_name",
]

T = TypeVar("T")

ROS1 = "ros1"
"""Encoding of messages serialised by ROS 1."""
CDR = "cdr"
"""Encoding of messages serialised by ROS 2."""
PROTOBUF = "protobuf"
"""Encoding of Foxglove's messages in protobuf."""
JSON = "json"
"""Encoding of messages as JSON."""

# The types of ROS 1's transforms, which the ROS 1 store of rosbags does not hold.
_ROS1_TRANSFORMS = "geometry_msgs/TransformStamped[] transforms\n"
_IDL_SEPARATOR = "=" * 80 + "\n"


class UndecodableMessageError(RecordingError):
    """The bytes of a message do not fit its type."""


@dataclass(frozen=True)
class Definition:
    """How the messages of one type are written in one recording.

    Attributes
    ----------
    encoding : str
        `ROS1`, `CDR`, `PROTOBUF`, `JSON`, or the name that an MCAP file gives another.
    language : str
        ``msg``, ``idl``, ``jsonschema``, ``protobuf``, or empty when the recording
        carries no definition.
    text : str
        The definition, its dependencies included.
    descriptors : bytes
        The definition where it is not text: a serialised FileDescriptorSet.
    """

    encoding: str
    language: str = ""
    text: str = ""
    descriptors: bytes = b""


def ros2_name(msgtype: str) -> str:
    """Name of a message type as ROS 2 writes it.

    Parameters
    ----------
    msgtype : str
        ``package/Type`` or ``package/msg/Type``.

    Returns
    -------
    str
        ``package/msg/Type``; a name of any other form as it is.
    """
    package, slash, name = msgtype.partition("/")
    return f"{package}/msg/{name}" if slash and "/" not in name else msgtype


def default_typestore(encoding: str) -> Typestore:
    """Message types to use where a recording defines none.

    Parameters
    ----------
    encoding : str
        `ROS1` or `CDR`.

    Returns
    -------
    rosbags.typesys.store.Typestore
        With the transform messages, which the store of rosbags for ROS 1 lacks.
    """
    from rosbags.typesys import Stores, get_types_from_msg, get_typestore

    if encoding != ROS1:
        return get_typestore(Stores.LATEST)
    store = get_typestore(Stores.ROS1_NOETIC)
    for name in ("tf2_msgs/msg/TFMessage", "tf/msg/tfMessage"):
        store.register(get_types_from_msg(_ROS1_TRANSFORMS, name))
    return store


class MessageCodec:
    """Decodes the messages of one recording.

    Parameters
    ----------
    definitions : mapping of str to Definition
        By message type, named as ROS 2 does.
    """

    def __init__(self, definitions: Mapping[str, Definition]) -> None:
        self._definitions = definitions
        self._decoders: dict[str, Callable[[bytes, str], object]] = {}

    def read(self, raw: bytes, msgtype: str, extract: Callable[[Any], T]) -> T:
        """Decode a message and take from it what is needed.

        Parameters
        ----------
        raw : bytes
        msgtype : str
            Named as ROS 2 does.
        extract : callable
            From the message object to the result. A field that it misses, since a
            recording may define a type in its own way, is an error of the message.

        Returns
        -------
        object
            What `extract` returns.

        Raises
        ------
        UndecodableMessageError
            If the type is not known, or the bytes or the fields do not fit it.
        """
        try:
            decoder = self._decoders.get(msgtype)
            if decoder is None:
                decoder = self._decoders[msgtype] = self._decoder(msgtype)
            return extract(decoder(raw, msgtype))
        except RecordingError:
            raise
        except Exception as error:  # generated code fails on bad bytes in many ways
            reason = " ".join(str(error).split()) or type(error).__name__
            raise UndecodableMessageError(
                f"a message of type {msgtype} ({len(raw)} bytes) cannot be decoded: {reason}"
            ) from error

    def encoding_of(self, msgtype: str) -> str:
        """Encoding of the messages of a type; empty when the type is not known."""
        definition = self._definitions.get(msgtype)
        return definition.encoding if definition else ""

    def _decoder(self, msgtype: str) -> Callable[[bytes, str], object]:
        definition = self._definitions.get(msgtype)
        make = _DECODERS.get(definition.encoding) if definition else None
        if definition is None or make is None:
            encoding = definition.encoding if definition else "an unknown encoding"
            raise UndecodableMessageError(f"{msgtype} in {encoding} cannot be decoded")
        return make(msgtype, definition)


def _ros1_decoder(msgtype: str, definition: Definition) -> Callable[[bytes, str], object]:
    return _typestore(msgtype, definition).deserialize_ros1


def _cdr_decoder(msgtype: str, definition: Definition) -> Callable[[bytes, str], object]:
    return _typestore(msgtype, definition).deserialize_cdr


def _protobuf_decoder(msgtype: str, definition: Definition) -> Callable[[bytes, str], object]:
    from beamseg_batch.recording.codec_protobuf import protobuf_decoder

    decode = protobuf_decoder(msgtype, definition.descriptors)
    return lambda raw, _: decode(raw)


def _json_decoder(_msgtype: str, definition: Definition) -> Callable[[bytes, str], object]:
    from beamseg_batch.recording.codec_json import json_decoder

    decode = json_decoder(definition.text)
    return lambda raw, _: decode(raw)


_DECODERS: Mapping[str, Callable[[str, Definition], Callable[[bytes, str], object]]] = {
    ROS1: _ros1_decoder,
    CDR: _cdr_decoder,
    PROTOBUF: _protobuf_decoder,
    JSON: _json_decoder,
}
"""Makers of decoders by encoding."""


@lru_cache(maxsize=64)  # compiling a type takes longer than reading many scans
def _typestore(msgtype: str, definition: Definition) -> Typestore:
    """Build the store of one type: the recording's own definition, else the default one."""
    from rosbags.typesys import Stores, TypesysError, get_typestore

    store = get_typestore(Stores.EMPTY)
    try:
        store.register(_parsed(msgtype, definition))
        store.get_msgdef(msgtype)
    except (TypesysError, KeyError):  # KeyError: the type, or one it is made of, is not defined
        return default_typestore(definition.encoding)
    return store


def _parsed(msgtype: str, definition: Definition) -> Any:
    from rosbags.typesys import get_types_from_idl, get_types_from_msg

    if definition.language == "msg":
        return get_types_from_msg(definition.text, msgtype)
    types: Any = {}
    if definition.language == "idl":
        for section in _idl_sections(definition.text):
            types.update(get_types_from_idl(section))
    return types


def _idl_sections(text: str) -> list[str]:
    """Split an IDL bundle: each section names its file in a first line to drop."""
    if not text.startswith(f"{_IDL_SEPARATOR}IDL: "):
        return [text]
    return [section.partition("\n")[2] for section in text.split(_IDL_SEPARATOR)[1:]]
