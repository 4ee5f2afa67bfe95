"""The wire decoder and encoder against the protocol buffers' own library."""

import os
import struct
from pathlib import Path

import pytest
from hypothesis import given
from hypothesis import strategies as st

from pmbm.datasets.waymo_files import OBJECTS, SUBMISSION
from pmbm.datasets.wire import WireError, decode, encode

SAMPLES = sorted((Path(__file__).parents[1] / "data" / "waymo").glob("*.bin"))
protobuf = pytest.importorskip("google.protobuf")

DOUBLE, FLOAT, INT64, BOOL, STRING, MESSAGE, INT32 = 1, 2, 3, 8, 9, 11, 5
"""Type numbers of descriptor.proto."""
MESSAGES = {
    "Box": [
        *[(n, k, DOUBLE) for n, k in [("center_x", 1), ("center_y", 2), ("center_z", 3)]],
        *[(n, k, DOUBLE) for n, k in [("width", 4), ("length", 5), ("height", 6), ("heading", 7)]],
    ],
    "Label": [
        *[("box", 1, "Box"), ("type", 3, INT32), ("id", 4, STRING)],
        ("tracking_difficulty_level", 6, INT32),
    ],
    "Object": [
        *[("object", 1, "Label"), ("score", 2, FLOAT), ("overlap_with_nlz", 3, BOOL)],
        *[("context_name", 4, STRING), ("frame_timestamp_micros", 5, INT64)],
    ],
    "Objects": [("objects", 1, "Object*")],
    "Submission": [
        *[("task", 1, INT32), ("unique_method_name", 2, STRING), ("authors", 3, "string*")],
        *[("affiliation", 4, STRING), ("description", 5, STRING), ("method_link", 6, STRING)],
        *[("inference_results", 11, "Objects"), ("sensor_type", 12, INT32)],
        *[("account_name", 13, STRING), ("object_types", 14, "int*")],
    ],
}


@pytest.fixture(scope="module")
def classes():
    """The library's message classes, from a descriptor built by hand."""
    from google.protobuf import descriptor_pb2, descriptor_pool, message_factory

    file = descriptor_pb2.FileDescriptorProto(name="oracle.proto", package="oracle")
    file.syntax = "proto2"
    for name, fields in MESSAGES.items():
        message = file.message_type.add(name=name)
        for field, number, kind in fields:
            repeated = isinstance(kind, str) and kind.endswith("*")
            plain = kind.rstrip("*") if isinstance(kind, str) else kind
            scalar = {"string": STRING, "int": INT32}.get(plain, plain)
            entry = message.field.add(name=field, number=number, label=3 if repeated else 1)
            if isinstance(scalar, int):
                entry.type = scalar
            else:
                entry.type, entry.type_name = MESSAGE, f".oracle.{scalar}"
    pool = descriptor_pool.DescriptorPool()
    pool.Add(file)
    return {
        name: message_factory.GetMessageClass(pool.FindMessageTypeByName(f"oracle.{name}"))
        for name in MESSAGES
    }


def plain(message):
    """A library's message as nested dicts of the fields that are set."""
    value = {}
    for field, content in message.ListFields():
        if hasattr(content, "ListFields"):
            value[field.name] = plain(content)
        elif hasattr(content, "append") or hasattr(content, "add"):
            items = list(content)
            value[field.name] = [plain(i) if hasattr(i, "ListFields") else i for i in items]
        else:
            value[field.name] = content
    return value


@pytest.mark.parametrize("path", SAMPLES, ids=lambda path: path.stem)
def test_samples_decode_and_encode_as_the_library_says(classes, path):
    content = path.read_bytes()
    ours = decode(content, OBJECTS)
    assert ours == plain(classes["Objects"].FromString(content))
    assert len(ours["objects"]) > 0
    again = encode(ours, OBJECTS)
    assert plain(classes["Objects"].FromString(again)) == ours


@pytest.mark.skipif("PMBM_DATA" not in os.environ, reason="PMBM_DATA is unset: no real file")
@pytest.mark.parametrize("name", ["fake_ground_truths", "fake_predictions"])
def test_real_files_decode_as_the_library_says(classes, name):
    content = (Path(os.environ["PMBM_DATA"]) / "waymo" / f"{name}.bin").read_bytes()
    ours = decode(content, OBJECTS)
    assert ours == plain(classes["Objects"].FromString(content))
    assert len(ours["objects"]) > 500


def test_submission(classes):
    value = {
        "task": 4,
        "unique_method_name": "pmbm",
        "authors": ["A", "Ö"],
        "inference_results": {"objects": [{"score": 0.5, "frame_timestamp_micros": -1}]},
        "object_types": [1, 2, 4],
        "sensor_type": 1,
    }
    content = encode(value, SUBMISSION)
    assert plain(classes["Submission"].FromString(content)) == value
    assert decode(content, SUBMISSION) == value


@given(data=st.data())
def test_spoiled_messages_as_the_library_says(classes, data):
    """What the library refuses we refuse; what both take means the same to both.

    Stricter than the library we are with a known field of a wrong wire type, which it keeps as
    unknown, with groups, which nothing of ours uses, and with texts that are not UTF-8.
    """
    from google.protobuf.message import DecodeError

    content = bytearray(data.draw(st.sampled_from(SAMPLES)).read_bytes())
    for _ in range(data.draw(st.integers(1, 3))):
        at = data.draw(st.integers(0, len(content) - 1))
        kind = data.draw(st.sampled_from(["change", "cut", "double"]))
        if kind == "change":
            content[at] = data.draw(st.integers(0, 255))
        elif kind == "cut":
            content = content[: max(at, 1)]
        else:
            content += content[at:]
    try:
        theirs = plain(classes["Objects"].FromString(bytes(content)))
    except DecodeError:
        theirs = None
    ours, refusal = None, ""
    try:
        ours = decode(bytes(content), OBJECTS)
    except WireError as error:
        refusal = str(error)
    if refusal:
        assert theirs is None or "wire type" in refusal or "UTF-8" in refusal
    else:
        assert repr(ours) == repr(theirs)


@pytest.mark.parametrize(
    ("content", "problem"),
    [
        (b"\x0a", "cut short"),
        (b"\x0a\x05\x00", "cut short"),
        (b"\x0a\xff\xff\xff\xff\x0f", "cut short"),
        (b"\x08\x01", "wire type 0 where 2 belongs"),
        (b"\x0b", "wire type 3"),
        (b"\x00\x00", "field number 0"),
        (b"\x80" * 11, "more than ten bytes"),
        (b"\x0a\x04\x22\x02\xff\xfe", "not UTF-8"),
        (b"\x0a\x09\x11" + struct.pack("<d", 1.0), "wire type 1 where 5 belongs"),
    ],
)
def test_bad_bytes(content, problem):
    with pytest.raises(WireError, match=problem):
        decode(content, OBJECTS)


def test_the_last_of_a_field_given_twice_holds_and_messages_merge(classes):
    first = encode({"objects": [{"object": {"box": {"center_x": 1.0, "width": 2.0}}}]}, OBJECTS)
    inner = encode({"objects": [{"object": {"box": {"center_x": 3.0}}}]}, OBJECTS)
    joined = first[2:] + inner[2:]
    content = b"\x0a" + bytes([len(joined)]) + joined
    ours = decode(content, OBJECTS)
    assert ours == {"objects": [{"object": {"box": {"center_x": 3.0, "width": 2.0}}}]}
    assert plain(classes["Objects"].FromString(content)) == ours
