"""The form of a scenario file, and what is said of one that does not fit.

World frame of everything below: x forward or east, y left or north, metres, seconds; angles are in
degrees here, where people write them, and end in `_deg`.
"""

from __future__ import annotations

from typing import Annotated, Any, Literal

from pydantic import BaseModel, ConfigDict, Field, ValidationError

from pmbm.errors import InputError, nearest_hint
from pmbm.labels import Label
from pmbm.wording import expected_of

Positive = Annotated[float, Field(gt=0)]
NotNegative = Annotated[float, Field(ge=0)]
Share = Annotated[float, Field(ge=0, le=1)]
Point = Annotated[list[float], Field(min_length=2, max_length=2)]
Pose = Annotated[list[float], Field(min_length=3, max_length=3)]
LabelName = Literal["car", "truck", "bus", "motorcyclist", "cyclist", "pedestrian", "other"]


class Form(BaseModel):
    """A table of a scenario file: unknown keys, coerced types and non-finite numbers are errors."""

    model_config = ConfigDict(
        extra="forbid",
        strict=True,
        frozen=True,
        allow_inf_nan=False,
        use_attribute_docstrings=True,
    )


class SensorForm(Form):
    """What the sensor can see, and where it stands if nothing carries it."""

    pose: Pose | None = Field(
        default=None, description="x, y, yaw_deg of a sensor that stands still"
    )
    max_range: Positive = 100.0
    """m; nothing beyond it is in the truth"""
    fov_deg: Annotated[float, Field(gt=0, le=360)] = 360.0
    """width of the field of view; 360 is all round"""
    fov_centre_deg: float = 0.0
    """its middle, from the sensor's own direction, counter-clockwise"""


class MountedSensorForm(Form):
    """One of several sensors, on what carries the scene's sensor: the ego, or a mast."""

    mount: Pose = Field(
        default=[0.0, 0.0, 0.0],
        description="x forward, y left, yaw_deg, in the frame of what carries it",
    )
    max_range: Positive | None = Field(
        default=None, description="default: as far as the scene's sensor reaches, less the offset"
    )
    fov_deg: Annotated[float, Field(gt=0, le=360)] = 360.0
    """width of the field of view; 360 is all round"""
    fov_centre_deg: float = 0.0
    """its middle, from the sensor's own direction, counter-clockwise"""
    rate: Annotated[int, Field(ge=1, le=100)] | None = Field(
        default=None, description="looks a second, a divisor of the scenario's rate, the default"
    )
    phase: NotNegative = Field(
        default=0.0, description="s of its first look, a whole number of the scenario's frames"
    )
    latency: NotNegative = Field(default=0.0, description="s from a look to its delivery")
    detector: dict[str, Any] | None = Field(
        default=None, description="as the scenario's table of that name, which is the default"
    )


class Occluder(Form):
    """A static thing that hides what is behind it: a box, or a convex polygon."""

    box: Annotated[list[float], Field(min_length=5, max_length=5)] | None = Field(
        default=None, description="x, y, length, width, yaw_deg"
    )
    polygon: Annotated[list[Point], Field(min_length=3)] | None = None
    """[x, y] of each corner, convex, m"""


class Body(Form):
    """What kind of thing it is; sizes default to those of its kind."""

    label: LabelName = "car"
    """what kind of thing it is"""
    length: Positive | None = None
    """m; default: usual for its label"""
    width: Positive | None = None
    """m; default: usual for its label"""
    height: Positive | None = None
    """m; default: usual for its label"""

    @property
    def kind(self) -> Label:
        return Label[self.label.upper()]

    @property
    def size(self) -> tuple[float, float, float]:
        length, width, height = self.kind.default_size
        return self.length or length, self.width or width, self.height or height


class RoadJitter(Form):
    """Half-widths of uniform draws, one a copy and trial."""

    position: NotNegative = 0.0
    """m along the road"""
    speed: NotNegative = 0.0
    """of the speed, m/s"""
    spawn: NotNegative = 0.0
    """of the time at which it appears, s"""


class Command(Form):
    """An order to a driver at a time: a lane to change to, a speed to aim at."""

    time: NotNegative
    """s at which it is given"""
    lane: Annotated[int, Field(ge=0)] | None = None
    """number of the lane to change to"""
    speed: NotNegative | None = None
    """m/s to aim at"""


class Driver(Body):
    """A vehicle on a road."""

    road: str
    """name of the road it begins on"""
    lane: Annotated[int, Field(ge=0)] = 0
    """0 is on the line of the road, each further one to the right"""
    position: float = Field(default=0.0, description="m along the road at the time of spawning")
    speed: NotNegative
    """m/s at the beginning"""
    target_speed: Positive | None = Field(default=None, description="default: speed")
    driver: Literal["idm", "cruise"] = "idm"
    """idm follows its leader; cruise keeps its speed and looks at nobody"""
    lane_changes: bool = Field(False, description="may change lane of its own will (MOBIL)")
    commands: list[Command] = []
    """what it is told, and when"""
    jitter: RoadJitter = RoadJitter()
    """how its beginning differs from trial to trial"""


class Actor(Driver):
    """Vehicles on a road that belong to the scene."""

    spawn: NotNegative = 0.0
    """s at which it appears"""
    despawn: Positive | None = None
    """s at which it is gone; default: never"""
    count: Annotated[int, Field(ge=0, le=2000)] = 1
    """copies, one behind the other"""
    spacing: float = Field(default=-20.0, description="m along the road from one copy to the next")


class Road(Form):
    """A straight road from `start` to `end`, or an arc about `centre`.

    Lane 0 lies on the line itself, each further lane one `width` to the right of travel.
    """

    start: Point | None = None
    """x, y of a straight road, m"""
    end: Point | None = None
    """x, y of a straight road, m"""
    centre: Point | None = None
    """x, y of an arc, m"""
    radius: Positive | None = None
    """of an arc, m"""
    from_deg: float | None = None
    """angle at which an arc begins, seen from its centre"""
    to_deg: float | None = Field(
        default=None, description="larger than from_deg: counter-clockwise"
    )
    lanes: Annotated[int, Field(ge=1, le=8)] = 1
    """side by side"""
    width: Positive = 4.0
    """of a lane, m"""
    speed_limit: Positive = 40.0
    """m/s"""
    leads_to: str | None = Field(
        default=None, description="the road that begins where this one ends"
    )


class RoadEntry(Body):
    """Cars that keep arriving at the start of a road, as a Poisson process."""

    road: str
    """name of the road they arrive on"""
    lane: Annotated[int, Field(ge=0)] = 0
    """its number"""
    position: float = 0.0
    """m along the road"""
    rate: NotNegative = Field(description="arrivals a second")
    speed: Positive
    """m/s on arrival and aimed at"""
    speed_jitter: NotNegative = 0.0
    """half-width of a uniform draw for each, m/s"""
    lane_changes: bool = False
    """may change lane of their own will (MOBIL)"""


class NetworkEntry(Body):
    """Cars that keep arriving on a lane of a registered scene, as a Poisson process."""

    lane: Annotated[list[str | int], Field(min_length=3, max_length=3)] = Field(
        description='from node, to node, number, as in ["ser", "ses", 0]'
    )
    position: float = 0.0
    """m along the lane"""
    rate: NotNegative
    """arrivals a second"""
    speed: Positive
    """m/s on arrival and aimed at"""
    speed_jitter: NotNegative = 0.0
    """half-width of a uniform draw for each, m/s"""
    destinations: list[str] = Field(default=[], description="nodes, one drawn for each car")


class Move(Form):
    """A stretch of a scripted path over which speed and heading change evenly."""

    seconds: Positive
    """that it takes"""
    speed: NotNegative | None = Field(default=None, description="at its end; default: as before")
    turn_deg: float = Field(default=0.0, description="left is positive")


class PathJitter(Form):
    """Half-widths of uniform draws, one a copy and trial."""

    x: NotNegative = 0.0
    """in x, m"""
    y: NotNegative = 0.0
    """in x, m"""
    yaw_deg: NotNegative = 0.0
    """of the heading, degrees"""
    speed: NotNegative = 0.0
    """of the speed, m/s"""
    spawn: NotNegative = 0.0
    """of the time at which it appears, s"""


class Path(Form):
    """A scripted motion: a start and moves, after which it goes straight on; or poses."""

    start: Point = [0.0, 0.0]
    """x, y, m"""
    yaw_deg: float = 0.0
    """heading at the start, counter-clockwise from x"""
    speed: NotNegative = 0.0
    """m/s at the start"""
    moves: list[Move] = []
    """one after the other; straight on afterwards"""
    poses: list[Annotated[list[float], Field(min_length=4, max_length=4)]] = Field(
        default=[],
        description="t, x, y, yaw_deg in order of t; the object exists from first to last",
    )


class Track(Path, Body):
    """Objects that move by script, are not seen by drivers, and brake for what is in their way."""

    label: LabelName = "car"
    """what kind of thing it is"""
    spawn: NotNegative = 0.0
    """s at which it appears"""
    despawn: Positive | None = None
    """s at which it is gone; default: never"""
    count: Annotated[int, Field(ge=0, le=5000)] = 1
    """copies"""
    offset: Point = Field(default=[0.0, 5.0], description="dx, dy from one copy to the next")
    per_row: Annotated[int, Field(ge=1)] | None = Field(
        default=None, description="so many copies in line, then a new row begins"
    )
    row_offset: Point = Field(default=[0.0, 8.0], description="dx, dy from one row to the next")
    jitter: PathJitter = PathJitter()
    """how its start differs from copy to copy and trial to trial"""


class Births(Body):
    """Objects that are born and die all the time, crossing the sensor's range."""

    rate: NotNegative = Field(description="births a second, at most 5")
    speed: Annotated[list[Positive], Field(min_length=2, max_length=2)] = [5.0, 15.0]
    """least and most, m/s"""
    popup: Share = Field(default=0.0, description="share born inside the range and not at its edge")
    vanish: Share = Field(
        default=0.0, description="share that dies inside the range and not at its edge"
    )


class Surroundings(Form):
    """The keys that every kind of scene may have."""

    sensor: SensorForm = SensorForm()
    """what the sensor can see, and where it stands"""
    occluders: dict[str, Occluder] = {}
    """static things that hide what is behind them, by name"""
    tracks: dict[str, Track] = {}
    """objects that move by script, by name"""
    overlaps: Literal["refused", "allowed"] = Field(
        default="refused",
        description="whether scripted objects may drive through each other; where not, births wait "
        "for a free way, followers brake, and what nevertheless overlaps is an error",
    )


class GymnasiumScene(Surroundings):
    """A scene that highway-env registers, through `gymnasium.make`; its ego carries the sensor."""

    kind: Literal["gymnasium"]
    """a scene that highway-env registers"""
    id: str
    """its name there, as in roundabout-v1"""
    config: dict[str, Any] = {}
    """its configuration there"""
    entries: dict[str, NetworkEntry] = {}
    """cars that keep arriving, by name"""
    crashes: Literal["allowed", "refused"] = "allowed"
    """whether a crash is an error"""


class RoadScene(Surroundings):
    """Our own roads with our own actors."""

    kind: Literal["road"]
    """own roads with own actors"""
    roads: dict[str, Road]
    """by name"""
    ego: Driver | None = Field(default=None, description="carries the sensor; is not in the truth")
    actors: dict[str, Actor] = {}
    """vehicles of the scene, by name"""
    entries: dict[str, RoadEntry] = {}
    """cars that keep arriving, by name"""
    crashes: Literal["allowed", "refused"] = "refused"
    """whether a crash is an error"""


class ScriptedScene(Surroundings):
    """Scripted motion alone: needs no traffic simulator."""

    kind: Literal["scripted"]
    """scripted motion alone"""
    ego: Path | None = Field(default=None, description="carries the sensor")
    births: dict[str, Births] = {}
    """objects that come and go all the time, by name"""


class RecordedScene(Surroundings):
    """Traffic from a file: a table of truth, a CommonRoad scenario, or floating car data of SUMO.
    The ground is flat here, an object's size and label do not change, and visibility is worked out.
    """

    kind: Literal["recorded"]
    file: str = Field(description="beside this one: .csv, .parquet, .xml or .xml.gz")
    types: list[str] = Field(
        default=[], description="of SUMO, the files that hold the vehicle types: lengths"
    )
    ego: str | None = Field(
        default=None, description="id of the vehicle that carries the sensor; is not in the truth"
    )
    start: float | None = Field(
        default=None, description="s, of the file's own time; default: its first"
    )
    classes: dict[str, Literal[LabelName, "ignored"]] = Field(
        default={}, description="the file's classes or types -> labels; ignored: left out"
    )


AnyScene = Annotated[
    GymnasiumScene | RoadScene | ScriptedScene | RecordedScene, Field(discriminator="kind")
]
Level = int | float


class Sweep(Form):
    """The one factor that the scenario isolates.

    The file as written has the factor off, and `levels[0]`, the null level, sets exactly that.
    `parameter` is a dotted key of the file; or, where one physical factor moves several keys, any
    name, and `set` lists for each key its value at each level.
    """

    parameter: str
    """a dotted key of this file, or any name beside set"""
    unit: str = ""
    """of the levels"""
    levels: Annotated[list[Level], Field(min_length=2)]
    """the null level first"""
    default: Level | None = Field(
        default=None, description="level of a plain run; default: the null level"
    )
    set: dict[str, list[Any]] = {}
    """dotted key -> its value at each level"""


class Check(Form):
    """Whether results can only get worse from level to level; `why` says so if not."""

    monotone: bool = True
    """whether a harder level may never be significantly better"""
    why: str = ""
    """the reason, where it may"""


class ScenarioForm(Form):
    """A scenario file."""

    name: Annotated[str, Field(pattern=r"^[a-z][a-z0-9_]*$")]
    """of the scenario: small letters, digits and _, a letter first"""
    stresses: Annotated[str, Field(min_length=10, description="one sentence: what is stressed")]
    duration: Annotated[float, Field(gt=0, le=3600)] = 20.0
    """s from the first frame to the last"""
    rate: Annotated[int, Field(ge=1, le=100, description="frames a second")] = 10
    simulation_rate: Annotated[int, Field(ge=1, le=200, description="steps a second")] = 20
    warmup: NotNegative = Field(default=0.0, description="s simulated before the first frame")
    scene: AnyScene
    """the world: who is there and how they move"""
    detector: dict[str, Any] = {"profile": "nominal"}
    """a profile and what differs from it; see docs and `pmbm fit-detector`"""
    sensors: dict[str, MountedSensorForm] = Field(
        default={}, description="several sensors instead of one, by name"
    )
    sweep: Sweep | None = None
    """the one factor that levels vary"""
    check: Check = Check()
    """what is known of the levels"""


def parse(document: dict[str, Any], file: object = None) -> ScenarioForm:
    """The document as a form; InputError names the file, the key, what was expected, and for an
    unknown key the nearest valid one."""
    try:
        form = ScenarioForm.model_validate(document)
    except ValidationError as error:
        raise _explain(error, file) from None
    return form


def json_schema() -> dict[str, Any]:
    """The JSON Schema of scenario files, for editors."""
    schema = ScenarioForm.model_json_schema()
    schema["properties"]["extends"] = {
        "type": "string",
        "description": "a scenario of the catalogue: its tables lie under those of this file",
    }
    # What a file leaves out it may have from the one that it extends.
    schema["required"] = ["name", "stresses"]
    schema["anyOf"] = [{"required": ["scene"]}, {"required": ["extends"]}]
    return {"$schema": "https://json-schema.org/draft/2020-12/schema", **schema}


_KINDS = {
    "gymnasium": GymnasiumScene,
    "road": RoadScene,
    "scripted": ScriptedScene,
    "recorded": RecordedScene,
}


def _explain(error: ValidationError, file: object) -> InputError:
    """The first problem, unknown keys before all others: they are what mistyped keys end as."""
    problems = error.errors(include_url=False)
    problem = min(problems, key=lambda p: p["type"] != "extra_forbidden")
    keys = [str(part) for part in problem["loc"]]
    if len(keys) > 1 and keys[0] == "scene" and keys[1] in _KINDS:
        del keys[1]
    place: dict[str, Any] = {"file": file, "field": ".".join(keys) or None}
    kind = problem["type"]
    if kind == "extra_forbidden":
        valid = _valid_keys(problem["loc"][:-1])
        if len(keys) == 1:
            valid.append("extends")
        return InputError(
            f"unknown key '{keys[-1]}'", **place, hint=nearest_hint(keys[-1], valid, "key")
        )
    if kind == "missing":
        return InputError(f"'{keys[-1]}' is missing", **place)
    if kind in ("union_tag_invalid", "union_tag_not_found"):
        got = problem["input"].get("kind") if isinstance(problem["input"], dict) else None
        place["field"] = "scene.kind"
        return InputError(
            "no such kind of scene" if got is not None else "'kind' is missing",
            **place,
            expected=" or ".join(f'"{kind}"' for kind in _KINDS),
            got=got,
            hint=None if got is None else nearest_hint(got, _KINDS, "kind"),
        )
    hint = None
    if kind == "literal_error":
        hint = nearest_hint(problem["input"], _choices(problem), "value")
    return InputError(
        "bad value", **place, expected=expected_of(problem), got=problem["input"], hint=hint
    )


def _choices(problem: Any) -> list[str]:
    return str(problem["ctx"]["expected"]).replace(" or ", ", ").replace("'", "").split(", ")


def _valid_keys(path: tuple[int | str, ...]) -> list[str]:
    """The keys that the table at this place of a document may have."""
    import typing

    form: Any = ScenarioForm
    for part in path:
        if isinstance(form, type) and issubclass(form, Form):
            if part in form.model_fields:
                form = form.model_fields[str(part)].annotation
            continue
        while typing.get_origin(form) is Annotated:
            form = typing.get_args(form)[0]
        arguments = [a for a in typing.get_args(form) if a is not type(None)]
        kinds = [a for a in arguments if isinstance(a, type) and issubclass(a, Form)]
        if part in _KINDS:
            form = _KINDS[str(part)]
        elif kinds:
            form = kinds[-1]
            if part in form.model_fields:
                form = form.model_fields[str(part)].annotation
    while not (isinstance(form, type) and issubclass(form, Form)):
        kinds = [a for a in typing.get_args(form) if isinstance(a, type) and issubclass(a, Form)]
        if not kinds:
            return []
        form = kinds[0]
    return list(form.model_fields)
