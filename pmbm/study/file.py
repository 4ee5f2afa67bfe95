"""Study files: TOML, judged here and nowhere else."""

from __future__ import annotations

import tomllib
from collections.abc import Mapping
from pathlib import Path
from typing import Annotated, Any

from pydantic import BaseModel, ConfigDict, Field, ValidationError

from pmbm.errors import InputError, nearest_hint
from pmbm.study.configured import ConfiguredTracker, config_of, merged, nested
from pmbm.study.design import Point, grid, latin_hypercube
from pmbm.study.study import Cell, Resolve, Study
from pmbm.wording import expected_of

_TRACKER = "tracker."


class _Form(BaseModel):
    model_config = ConfigDict(extra="forbid", strict=True, frozen=True, allow_inf_nan=False)


class TrackerForm(_Form):
    """A tracker with parameters, under a name of its own."""

    factory: str = Field(description="a shipped tracker, MODULE:FACTORY or exec:COMMAND")
    config: str | None = Field(
        default=None, description="a TOML file of parameters, beside this one; those here go first"
    )
    parameters: dict[str, Any] = {}


class LatinHypercube(_Form):
    """Points spread evenly over ranges."""

    samples: Annotated[int, Field(ge=1)]
    seed: Annotated[int, Field(ge=0)] = 0
    ranges: dict[str, Annotated[list[float], Field(min_length=2, max_length=2)]]


class StudySweep(_Form):
    """What varies: keys of the scenarios ("detector.clutter_rate", "level") and parameters of
    trackers ("tracker.NAME.KEY").  Every grid point meets every point of the hypercube."""

    grid: dict[str, list[Any]] = {}
    latin_hypercube: LatinHypercube | None = None


class Limits(_Form):
    """The limits of one trial."""

    seconds: Annotated[float, Field(gt=0)] | None = None
    megabytes: Annotated[float, Field(gt=0)] | None = None


class GateForm(_Form):
    """The rules of `pmbm gate`; see `pmbm.regression.Rules`."""

    metric: str = "ospa"
    bounds: Annotated[list[float], Field(min_length=2, max_length=2)] | None = None
    margin: float | None = None
    relative_margin: float | None = None
    alpha: float = 0.01
    rarest: float = 0.05
    max_trials: int = 600
    candidate: str | None = None


class StudyForm(_Form):
    """A study file."""

    name: str | None = Field(default=None, description="default: the file's name")
    scenarios: Annotated[list[str], Field(min_length=1)]
    trackers: Annotated[list[str], Field(min_length=1)] = ["pmbm"]
    trials: Annotated[int, Field(ge=1)] = 20
    seed: Annotated[int, Field(ge=0)] = 0
    metrics: Annotated[list[str], Field(min_length=1)] | None = None
    tracker: dict[str, TrackerForm] = {}
    sweep: StudySweep = StudySweep()
    limits: Limits = Limits()
    gate: GateForm | None = None


def load_study(file: Path | str, resolve: Resolve) -> Study:
    """The study in a TOML file; names of scenarios that end in .toml are found beside it.

    resolve : turns the names of scenarios into Sources.
    Raises InputError naming file and key.
    """
    file = Path(file)
    form = _parse(file)
    try:
        return _study(form, file, resolve)
    except InputError as error:
        raise error.located(file=error.file or file) from None


def json_schema() -> dict[str, Any]:
    """The JSON Schema of study files, for editors."""
    schema = StudyForm.model_json_schema()
    return {"$schema": "https://json-schema.org/draft/2020-12/schema", **schema}


def _study(form: StudyForm, file: Path, resolve: Resolve) -> Study:
    _each_once("scenarios", form.scenarios)
    _each_once("trackers", form.trackers)
    design = _design(form.sweep)
    _check_tracker_keys(form, design)
    candidate = None if form.gate is None else form.gate.candidate
    if candidate is not None and candidate not in form.trackers:
        hint = nearest_hint(candidate, form.trackers, "tracker")
        raise InputError(f"no tracker '{candidate}'", field="gate.candidate", hint=hint)
    cells = tuple(
        Cell(
            scenario=name,
            point=point,
            source=resolve(_beside(name, file), _world(point)),
            trackers={t: _tracker(t, form.tracker.get(t), file, point) for t in form.trackers},
        )
        for name in form.scenarios
        for point in design
    )
    return Study(
        name=form.name or file.stem,
        cells=cells,
        trials=form.trials,
        seed=form.seed,
        metrics=None if form.metrics is None else tuple(form.metrics),
        gate={} if form.gate is None else form.gate.model_dump(),
        time_limit=form.limits.seconds,
        memory_limit=form.limits.megabytes,
    )


def _design(sweep: StudySweep) -> list[Point]:
    points = grid(sweep.grid)
    cube = sweep.latin_hypercube
    if cube is None:
        return points
    both = sorted(set(sweep.grid) & set(cube.ranges))
    if both:
        raise InputError("swept twice", field=f"sweep.latin_hypercube.ranges.{both[0]}")
    ranges = {name: (low, high) for name, (low, high) in cube.ranges.items()}
    samples = latin_hypercube(ranges, cube.samples, cube.seed)
    return [{**point, **sample} for point in points for sample in samples]


def _world(point: Point) -> Point:
    return {key: value for key, value in point.items() if not key.startswith(_TRACKER)}


def _tracker(name: str, written: TrackerForm | None, file: Path, point: Point) -> ConfiguredTracker:
    factory = name if written is None else written.factory
    parameters: dict[str, Any] = {}
    if written is not None:
        stored = {} if written.config is None else _document(file.parent / written.config)
        parameters = merged(nested(stored), nested(written.parameters), config_of(factory))
    own = f"{_TRACKER}{name}."
    parameters |= {key[len(own) :]: v for key, v in point.items() if key.startswith(own)}
    return ConfiguredTracker(factory, tuple(sorted(parameters.items())))


def _check_tracker_keys(form: StudyForm, design: list[Point]) -> None:
    for name in form.tracker:
        if name not in form.trackers:
            raise InputError(
                "configured, but not in trackers",
                field=f"tracker.{name}",
                hint=nearest_hint(name, form.trackers, "tracker"),
            )
    for key in design[0]:
        if not key.startswith(_TRACKER):
            continue
        swept = key.removeprefix(_TRACKER)
        if not any(swept.startswith(f"{name}.") for name in form.trackers):
            owner = swept.partition(".")[0]
            raise InputError(
                f"no tracker '{owner}' in this study",
                field=f"sweep: {key}",
                hint=nearest_hint(owner, form.trackers, "tracker"),
            )


def _each_once(field: str, names: list[str]) -> None:
    twice = [name for name in names if names.count(name) > 1]
    if twice:
        raise InputError("named twice", field=field, got=twice[0])


def _beside(name: str, file: Path) -> str:
    return str(file.parent / name) if name.endswith(".toml") else name


def _document(file: Path) -> dict[str, Any]:
    try:
        return tomllib.loads(file.read_text(encoding="utf-8-sig"))
    except OSError as error:
        raise InputError(f"cannot read it: {error.strerror}", file=file) from error
    except (UnicodeDecodeError, tomllib.TOMLDecodeError) as error:
        raise InputError(f"not TOML: {error}", file=file) from error


def _parse(file: Path) -> StudyForm:
    try:
        return StudyForm.model_validate(_document(file))
    except ValidationError as error:
        problems = error.errors(include_url=False)
    # Unknown keys first: a mistyped key is also a missing one.
    problem = min(problems, key=lambda p: p["type"] != "extra_forbidden")
    key = ".".join(map(str, problem["loc"]))
    if problem["type"] == "extra_forbidden":
        hint = nearest_hint(problem["loc"][-1], _valid_keys(problem["loc"][:-1]), "key")
        raise InputError("unknown key", file=file, field=key, hint=hint)
    if problem["type"] == "missing":
        raise InputError("missing key", file=file, field=key)
    raise InputError(
        "bad value", file=file, field=key, expected=expected_of(problem), got=problem["input"]
    )


def _valid_keys(path: tuple[int | str, ...]) -> list[str]:
    """The keys that the table at this place may have."""
    tables: Mapping[str, type[_Form]] = {
        "tracker": TrackerForm,
        "sweep": StudySweep,
        "limits": Limits,
        "gate": GateForm,
        "latin_hypercube": LatinHypercube,
    }
    form = next((tables[str(part)] for part in reversed(path) if part in tables), StudyForm)
    return list(form.model_fields)
