"""The lines that pass between the testbed and a program: JSON, a column a field.

docs/guide/tracker_protocol.schema.json holds their JSON Schema.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any, Final

import numpy as np
import orjson

from pmbm.errors import InputError, nearest_hint
from pmbm.external.process import STDERR_IS_FREE
from pmbm.types import Detections, Label, Site, Tracks

PROTOCOL: Final = 1
"""Version of what the lines hold."""
_LABELS: Final = tuple(label.name.lower() for label in Label)
_CODES: Final = {name: label.value for name, label in zip(_LABELS, Label, strict=True)}
_BOX: Final = ("x", "y", "z", "length", "width", "height", "yaw")
_COLUMNS: Final = ("id", *_BOX, "vx", "vy", "score", "label")
_EXTRAS: Final = ("covariance", "seconds")
_DUMP: Final = orjson.OPT_SERIALIZE_NUMPY | orjson.OPT_APPEND_NEWLINE


def greeting(site: Site, seed: int, parameters: Mapping[str, Any]) -> bytes:
    """The line that begins a recording.

    Raises InputError for a parameter that JSON cannot hold.
    """
    message = {
        "type": "start",
        "protocol": PROTOCOL,
        "seed": seed,
        "parameters": dict(parameters),
        "labels": _LABELS,
        "site": {
            "occluders": [polygon.tolist() for polygon in site.occluders],
            "fov_centre": site.fov_centre,
            "fov_half_angle": site.fov_half_angle,
            "max_range": site.max_range,
            "drivable_area": None
            if site.drivable_area is None
            else [polygon.tolist() for polygon in site.drivable_area],
            "sensors": [
                {
                    "name": one.name,
                    "mount": dict(zip(("x", "y", "yaw"), one.mount.tolist(), strict=True)),
                    "fov_centre": one.fov_centre,
                    "fov_half_angle": one.fov_half_angle,
                    "max_range": one.max_range,
                    "latency": one.latency,
                }
                for one in site.sensors
            ],
        },
    }
    try:
        return orjson.dumps(message, option=_DUMP)
    except TypeError as error:
        raise InputError(f"a parameter that JSON cannot hold: {error}", got=parameters) from None


def check_ready(line: bytes) -> None:
    """Raise InputError unless a line answers the greeting in this version of the protocol."""
    message = _message(line, "ready")
    if message.get("protocol") != PROTOCOL:
        raise InputError(
            "another protocol",
            field="protocol",
            expected=PROTOCOL,
            got=message.get("protocol"),
        )


def frame_line(step: int, detections: Detections) -> bytes:
    """The line of one delivery of detections; `step` counts them from the greeting on."""
    x, y, z = np.ascontiguousarray(detections.position.T)
    length, width, height = np.ascontiguousarray(detections.size.T)
    pose = dict(zip(("x", "y", "yaw"), detections.sensor_pose.tolist(), strict=True))
    message: dict[str, Any] = {
        "type": "frame",
        "step": step,
        "time": detections.time,
        "sensor": {"name": detections.sensor, **pose},
        "x": x,
        "y": y,
        "z": z,
        "length": length,
        "width": width,
        "height": height,
        "yaw": detections.yaw,
        "score": detections.score,
        "label": [_LABELS[code] for code in detections.label.tolist()],
    }
    if detections.raw_score is not None:
        message["raw_score"] = detections.raw_score
    if detections.radial_velocity is not None:
        message["radial_velocity"] = detections.radial_velocity
    if detections.sensor_velocity is not None:
        vx, vy = detections.sensor_velocity.tolist()
        message["sensor"] |= {"vx": vx, "vy": vy}
    return orjson.dumps(message, option=_DUMP)


def read_tracks(line: bytes, step: int, time: float) -> tuple[Tracks, float | None]:
    """The tracks in the answer to a step, and the seconds that the program says it took.

    time : of the detections, s.

    Raises InputError where the line is something else, or answers another step.
    """
    message = _message(line, "tracks")
    if message.get("step") != step:
        raise InputError("an answer out of order", field="step", expected=step,
                         got=message.get("step"))  # fmt: skip
    for name in message:
        if name not in _COLUMNS and name not in _EXTRAS and name not in ("type", "step"):
            hint = nearest_hint(name, [*_COLUMNS, *_EXTRAS], "column")
            raise InputError("an unknown column", field=name, hint=hint)
    columns = {name: _column(message, name) for name in _COLUMNS}
    rows = len(columns["id"])
    for name, values in columns.items():
        if len(values) != rows:
            raise InputError(
                "columns of different lengths", field=name, expected=rows, got=len(values)
            )
    seconds = message.get("seconds")
    if seconds is not None and not (type(seconds) in (int, float) and 0 <= seconds < np.inf):
        raise InputError("not a time", field="seconds", expected="at least 0", got=seconds)
    if not rows:
        return Tracks.empty(time), seconds
    return Tracks(
        time=time,
        id=np.array(columns["id"]),
        position=_beside(columns, _BOX[:3]),
        size=_beside(columns, _BOX[3:6]),
        yaw=_beside(columns, ("yaw",))[:, 0],
        velocity=_beside(columns, ("vx", "vy")),
        score=_beside(columns, ("score",))[:, 0],
        label=np.array([_code(name) for name in columns["label"]], dtype=np.int8),
        covariance=_covariance(message.get("covariance"), rows),
    ), seconds


def _message(line: bytes, kind: str) -> dict[str, Any]:
    try:
        message = orjson.loads(line)
    except orjson.JSONDecodeError as error:
        # Python's json module writes NaN and Infinity, which are no JSON.
        wrong = next((word for word in ("NaN", "Infinity") if word.encode() in line), None)
        what = f"{wrong} in it" if wrong else f"not JSON: {error.msg}"
        raise InputError(
            f"an answer with {what}" if wrong else f"an answer that is {what}",
            expected=f"one JSON object of type '{kind}'",
            got=line.decode(errors="replace").strip(),
            hint=None if wrong else STDERR_IS_FREE,
        ) from None
    if not isinstance(message, dict) or message.get("type") != kind:
        raise InputError(
            "an answer of another type",
            field="type",
            expected=f"one JSON object of type '{kind}'",
            got=message.get("type") if isinstance(message, dict) else type(message).__name__,
        )
    return message


def _column(message: Mapping[str, Any], name: str) -> list[Any]:
    values = message.get(name)
    if not isinstance(values, list):
        raise InputError(
            "a missing column" if values is None else "not a column",
            field=name,
            expected="a list",
            got=values,
        )
    return values


def _beside(columns: Mapping[str, list[Any]], names: tuple[str, ...]) -> Any:
    """Columns as a table, a row an object; what is no finite number is named."""
    for name in names:
        for row, value in enumerate(columns[name]):
            # A program in C++ writes null for NaN.
            if type(value) not in (float, int):
                raise InputError(
                    "not a number",
                    field=name,
                    rows=[row],
                    expected="a finite number",
                    got="null" if value is None else value,
                )
    return np.array([columns[name] for name in names], dtype=np.float64).T


def _code(name: Any) -> int:
    code = _CODES.get(name) if isinstance(name, str) else None
    if code is None:
        raise InputError(
            "an unknown label", field="label", got=name, hint=nearest_hint(name, _LABELS, "label")
        )
    return code


def _covariance(given: Any, rows: int) -> Any:
    if given is None:
        return None
    try:
        table = np.array(given)
    except ValueError:
        table = np.zeros(0)
    if table.shape != (rows, 4, 4) or table.dtype.kind not in "if":
        raise InputError(
            "not a table of covariances",
            field="covariance",
            expected=f"numbers of shape ({rows}, 4, 4)",
        )
    return table.astype(np.float64)
