"""JSON Schemas, by Foxglove's names, of the messages that it draws and that we write."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any, Final

_NUMBER: Final = {"type": "number"}
_TEXT: Final = {"type": "string"}
_FLAG: Final = {"type": "boolean"}
_COUNT: Final = {"type": "integer", "minimum": 0}


def _object(title: str, **properties: Any) -> dict[str, Any]:
    return {
        "title": title,
        "type": "object",
        "properties": properties,
        "required": list(properties),
    }


def _numbers(title: str, names: str) -> dict[str, Any]:
    """An object of numbers, each named by one letter."""
    return _object(title, **dict.fromkeys(names, _NUMBER))


def _unused(kind: str) -> dict[str, Any]:
    """A list of things that Foxglove draws and that we never write."""
    return _list({"title": f"foxglove.{kind}Primitive", "type": "object"})


def _list(items: Mapping[str, Any]) -> dict[str, Any]:
    return {"type": "array", "items": items}


_TIME: Final = _object("time", sec=_COUNT, nsec={**_COUNT, "maximum": 999_999_999})
_VECTOR2: Final = _numbers("foxglove.Vector2", "xy")
_VECTOR3: Final = _numbers("foxglove.Vector3", "xyz")
_POINT3: Final = _numbers("foxglove.Point3", "xyz")
_TURN: Final = _numbers("foxglove.Quaternion", "xyzw")
_POSE: Final = _object("foxglove.Pose", position=_VECTOR3, orientation=_TURN)
_COLOUR: Final = _numbers("foxglove.Color", "rgba")
_CUBE: Final = _object("foxglove.CubePrimitive", pose=_POSE, size=_VECTOR3, color=_COLOUR)
_LINE: Final = _object(
    "foxglove.LinePrimitive",
    type=_COUNT,
    pose=_POSE,
    thickness=_NUMBER,
    scale_invariant=_FLAG,
    points=_list(_POINT3),
    color=_COLOUR,
    colors=_list(_COLOUR),
    indices=_list(_COUNT),
)
_WRITING: Final = _object(
    "foxglove.TextPrimitive",
    pose=_POSE,
    billboard=_FLAG,
    font_size=_NUMBER,
    scale_invariant=_FLAG,
    color=_COLOUR,
    text=_TEXT,
)
_ENTITY: Final = _object(
    "foxglove.SceneEntity",
    timestamp=_TIME,
    frame_id=_TEXT,
    id=_TEXT,
    lifetime=_object("duration", sec={"type": "integer"}, nsec=_COUNT),
    frame_locked=_FLAG,
    metadata=_list(_object("foxglove.KeyValuePair", key=_TEXT, value=_TEXT)),
    arrows=_unused("Arrow"),
    cubes=_list(_CUBE),
    spheres=_unused("Sphere"),
    cylinders=_unused("Cylinder"),
    lines=_list(_LINE),
    triangles=_unused("TriangleList"),
    texts=_list(_WRITING),
    models=_unused("Model"),
)

_SCENE_UPDATE: Final = _object(
    "foxglove.SceneUpdate",
    deletions=_list(
        _object("foxglove.SceneEntityDeletion", timestamp=_TIME, type=_COUNT, id=_TEXT)
    ),
    entities=_list(_ENTITY),
)
_FRAME_TRANSFORM: Final = _object(
    "foxglove.FrameTransform",
    timestamp=_TIME,
    parent_frame_id=_TEXT,
    child_frame_id=_TEXT,
    translation=_VECTOR3,
    rotation=_TURN,
)
_GRID: Final = _object(
    "foxglove.Grid",
    timestamp=_TIME,
    frame_id=_TEXT,
    pose=_POSE,
    column_count=_COUNT,
    cell_size=_VECTOR2,
    row_stride=_COUNT,
    cell_stride=_COUNT,
    fields=_list(_object("foxglove.PackedElementField", name=_TEXT, offset=_COUNT, type=_COUNT)),
    data={"type": "string", "contentEncoding": "base64"},
)
_METRICS: Final[dict[str, Any]] = {
    "title": "pmbm.Metrics",
    "type": "object",
    "properties": {"timestamp": _TIME},
    "required": ["timestamp"],
    "additionalProperties": _NUMBER,
}
"""A number for each metric that a step defines."""

SCHEMAS: Final[dict[str, dict[str, Any]]] = {
    str(schema["title"]): schema for schema in (_SCENE_UPDATE, _FRAME_TRANSFORM, _GRID, _METRICS)
}
