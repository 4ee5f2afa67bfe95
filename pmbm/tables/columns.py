"""The columns of the tables of a recording; SI units, radians."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Final, Literal

from pmbm.validation import Bounds

Kind = Literal["number", "integer", "flag", "text"]

_LENGTH: Final = Bounds(-1e8, 1e8)
_SIZE: Final = Bounds(above=0.0, most=1000.0)
_TIME: Final = Bounds(-9e9, 9e9)
"""Within which nanoseconds are 64-bit integers."""
_SHARE: Final = Bounds(0.0, 1.0)


@dataclass(frozen=True)
class Column:
    """A column of a table: what its cells are, and what an empty one stands for.

    needed : whether it has to be there; `frame` and `time` may stand for each other.
    """

    name: str
    kind: Kind
    unit: str
    default: str
    meaning: str
    needed: bool = False
    bounds: Bounds = field(default_factory=Bounds)


def _needed(name: str, kind: Kind, unit: str, meaning: str, bounds: Bounds | None = None) -> Column:
    return Column(name, kind, unit, "needed", meaning, True, bounds or Bounds())


_FRAME: Final = Column("frame", "integer", "", "needed, or time", "number of the frame")
_AT: Final = Column("time", "number", "s", "needed, or frame", "of the frame", bounds=_TIME)
_BOX: Final = (
    _needed("x", "number", "m", "centre", _LENGTH),
    _needed("y", "number", "m", "centre", _LENGTH),
    Column("z", "number", "m", "height / 2", "centre", bounds=_LENGTH),
    Column("length", "number", "m", "usual for the class", "along the heading", bounds=_SIZE),
    Column("width", "number", "m", "usual for the class", "across the heading", bounds=_SIZE),
    Column("height", "number", "m", "usual for the class", "upwards", bounds=_SIZE),
    Column("yaw", "number", "rad", "0", "heading, counter-clockwise from x", bounds=_LENGTH),
)
_CLASS: Final = Column("class", "text", "", "other", "a label's name, or one of `[classes]`")
_VELOCITY: Final = (
    Column("vx", "number", "m/s", "differences of x", "over ground", bounds=_LENGTH),
    Column("vy", "number", "m/s", "differences of y", "over ground", bounds=_LENGTH),
)
_SCORE: Final = Column("score", "number", "", "1", "confidence", bounds=_SHARE)
_ID: Final = _needed("id", "text", "", "the object's, once in a frame")

COLUMNS: Final[Mapping[str, tuple[Column, ...]]] = {
    "truth": (
        _FRAME,
        _AT,
        _ID,
        *_BOX,
        *_VELOCITY,
        _CLASS,
        Column("visibility", "number", "", "1", "share that is not hidden", bounds=_SHARE),
        Column("observable", "flag", "", "visibility >= 0.1", "whether it can be detected"),
        Column("crashed", "flag", "", "0", "whether it has collided"),
        Column("name", "text", "", "none", "what the source calls the object"),
        Column("observable_by", "text", "", "none", "sensors that could see it, blanks between"),
    ),
    "detections": (
        _FRAME,
        _AT,
        *_BOX,
        _SCORE,
        Column("raw_score", "number", "", "none", "the detector's own score", bounds=_LENGTH),
        _CLASS,
        Column("truth_id", "text", "", "clutter", "id of the object that caused it"),
        Column("delivery", "integer", "", "the frame's one", "number of the delivery"),
        Column("sensor", "text", "", "the frame's one", "name of the sensor, as in the poses"),
        Column("radial_velocity", "number", "m/s", "none", "away from the sensor", bounds=_LENGTH),
    ),
    "tracks": (_FRAME, _AT, _ID, *_BOX, *_VELOCITY, _SCORE, _CLASS),
    "poses": (
        _FRAME,
        _AT,
        Column("stamp", "integer", "", "time in ns", "time in the source's own unit"),
        Column("x", "number", "m", "0", "of the sensor in the world", bounds=_LENGTH),
        Column("y", "number", "m", "0", "of the sensor in the world", bounds=_LENGTH),
        Column("z", "number", "m", "0", "of the origin of boxes in the world", bounds=_LENGTH),
        Column("yaw", "number", "rad", "0", "of the sensor", bounds=_LENGTH),
        Column("pitch", "number", "rad", "0", "nose down is positive", bounds=Bounds(-1.4, 1.4)),
        Column("roll", "number", "rad", "0", "left side up is positive", bounds=Bounds(-1.4, 1.4)),
        Column("delivered", "flag", "", "1", "whether detections came, be it none"),
        Column("delivery_time", "number", "s", "time", "of the detections", bounds=_TIME),
        Column("sensor", "text", "", "none", "name of one of several sensors"),
        Column("vx", "number", "m/s", "none", "of the sensor in the world", bounds=_LENGTH),
        Column("vy", "number", "m/s", "none", "of the sensor in the world", bounds=_LENGTH),
    ),
}
"""Table -> its columns, in the order in which they are written."""
