"""Score a tracker's output against a recording's truth."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import asdict, dataclass, field
from functools import cached_property
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray

from pmbm.errors import InputError
from pmbm.labels import Label
from pmbm.metrics import catalogue
from pmbm.metrics.calibration import reliability
from pmbm.metrics.clear import Matches, clear_counts, clear_matches, gated_pairs
from pmbm.metrics.consistency import normalised_squares
from pmbm.metrics.gospa import gospa_series
from pmbm.metrics.hota import distance_similarity, hota_counts
from pmbm.metrics.identity import identity_counts
from pmbm.metrics.ospa import ospa_series
from pmbm.metrics.parameters import MetricParameters
from pmbm.metrics.result import OBSERVABLE, Evaluation, MetricValue, Samples
from pmbm.metrics.scene import Scene, scene_of
from pmbm.metrics.siap import siap_associations, siap_counts
from pmbm.metrics.testbed import object_measures, occlusion_measures, velocity_error, yaw_error
from pmbm.metrics.tgospa import tgospa
from pmbm.metrics.trajectory import ospa2_series
from pmbm.types import Recording, Tracks, TrackSequence

FloatArray = NDArray[np.float64]


def evaluate(
    recording: Recording,
    tracks: TrackSequence | Sequence[Tracks],
    metrics: Iterable[str] | None = None,
    *,
    parameters: MetricParameters | None = None,
    per_class: bool = False,
) -> Evaluation:
    """Score tracks against the truth of the frames that were stepped.

    tracks : what `run` gave, or one `Tracks` value per frame of truth.
    metrics : names; by default all but "tgospa" (costly), the SIAP attributes and the calibration
        of existence.  A name scores all objects; the same name with "_observable" at its end
        scores observable objects only.
    parameters : cutoffs, orders and gates.
    per_class : also score each class alone, truth and tracks of that label.

    Observable objects only: objects that are not observable in a frame are ignored there.  The
    standard CLEAR matching over all objects says which tracks follow them; those objects and those
    tracks are taken out of that frame, so that matched they count neither way and missed they are
    no miss, and the metric is computed on what is left.  The testbed's own measures of objects and
    occlusions (delay, ghost time, life, id kept, coasting) follow objects in and out of sight by
    their definition; for them the name with "_observable" is the same value.

    Raises InputError for an unknown name, unequal frames, or times that do not increase.
    """
    parameters = parameters or MetricParameters()
    if isinstance(metrics, str):
        metrics = [metrics]
    chosen = tuple(dict.fromkeys(catalogue.DEFAULT_METRICS if metrics is None else metrics))
    for name in chosen:
        catalogue.definition(name)
    scene = scene_of(recording, tracks)
    classes: dict[Label, Evaluation] = {}
    if per_class:
        for label in np.union1d(scene.truth.label, scene.tracks.label):
            part = scene.with_rows(scene.truth.label == label, scene.tracks.label == label)
            classes[Label(label)] = Evaluation(_values(part, chosen, parameters))
    return Evaluation(_values(scene, chosen, parameters), per_class=classes)


def observable_scene(scene: Scene, matches: Matches) -> Scene:
    """The scene without unobservable truth rows and without the track rows matched to them."""
    ignored = np.zeros(len(scene.tracks), np.bool_)
    ignored[matches.track[~scene.truth.observable[matches.truth]]] = True
    return scene.with_rows(scene.truth.observable, ~ignored)


@dataclass(frozen=True, eq=False, kw_only=True)
class _Tally:
    """What one group of metrics counted, its per-frame series, and with which parameters."""

    counts: Mapping[str, Any]
    series: Mapping[str, FloatArray]
    parameters: Mapping[str, Any]


@dataclass(frozen=True, eq=False, kw_only=True)
class _Work:
    """A scene, and what several metrics need of it, made once."""

    scene: Scene
    parameters: MetricParameters
    tallies: dict[str, _Tally] = field(default_factory=dict)

    def __post_init__(self) -> None:
        # Found once at the farthest that most of them look, and kept for the nearer.
        self.scene.near(max(self.parameters.ospa_cutoff, self.parameters.gospa_cutoff))

    @cached_property
    def matches(self) -> Matches:
        return clear_matches(self.scene, self.parameters.gate)

    @cached_property
    def observable(self) -> _Work:
        if self.scene.truth.observable.all():
            return self
        return _Work(scene=observable_scene(self.scene, self.matches), parameters=self.parameters)

    def tally(self, group: str) -> _Tally:
        if group not in self.tallies:
            self.tallies[group] = _GROUPS[group](self)
        return self.tallies[group]


def _values(
    scene: Scene, names: Iterable[str], parameters: MetricParameters
) -> tuple[MetricValue, ...]:
    everything = _Work(scene=scene, parameters=parameters)
    values = []
    for name in names:
        entry = catalogue.definition(name)
        narrowed = name.endswith(OBSERVABLE)
        follows = entry.group in _FOLLOW_OBJECTS
        work = everything.observable if narrowed and not follows else everything
        tally = work.tally(entry.group)
        values.append(
            entry.value(
                tally.counts,
                scope="observable" if narrowed else "all",
                parameters=tally.parameters,
                series=None if entry.series is None else tally.series[entry.series],
            )
        )
    return tuple(values)


def _gospa(work: _Work) -> _Tally:
    p = work.parameters
    result = gospa_series(work.scene, p.gospa_cutoff, p.gospa_order)
    series = {key: value for key, value in vars(result).items() if key != "pairs"}
    return _framewise(
        work, series, cutoff=p.gospa_cutoff, order=p.gospa_order, alpha=2.0, distance="xy"
    )


def _ospa(work: _Work) -> _Tally:
    p = work.parameters
    result = ospa_series(work.scene, p.ospa_cutoff, p.ospa_order)
    return _framewise(work, vars(result), cutoff=p.ospa_cutoff, order=p.ospa_order, distance="xy")


def _ospa2(work: _Work) -> _Tally:
    p = work.parameters
    period = work.scene.period
    window = 1 if period is None else max(1, round(p.ospa2_window / period))
    result = ospa2_series(work.scene, window, p.ospa_cutoff, p.ospa_order)
    return _framewise(
        work,
        vars(result),
        cutoff=p.ospa_cutoff,
        order=p.ospa_order,
        window=p.ospa2_window,
        distance="xy",
    )


def _clear(work: _Work) -> _Tally:
    counts = clear_counts(work.scene, work.matches)
    return _Tally(
        counts=asdict(counts),
        series={},
        parameters={"gate": work.parameters.gate, "distance": "xyz"},
    )


def _identity(work: _Work) -> _Tally:
    together = gated_pairs(work.scene, work.parameters.gate)
    return _Tally(
        counts=asdict(identity_counts(work.scene, together)),
        series={},
        parameters={"gate": work.parameters.gate, "distance": "xyz"},
    )


def _hota(work: _Work) -> _Tally:
    zero_at = work.parameters.similarity_zero
    pairs = work.scene.near(zero_at)
    similarity = distance_similarity(pairs.distance_xyz, zero_at)
    return _Tally(
        counts=asdict(hota_counts(work.scene, pairs, similarity)),
        series={},
        parameters={"similarity_zero": zero_at, "distance": "xyz"},
    )


def _cardinality(work: _Work) -> _Tally:
    frames = len(work.scene)
    error = work.scene.tracks.count(frames) - work.scene.truth.count(frames)
    return _framewise(work, {"error": error.astype(np.float64), "absolute": np.abs(error)})


def _motion(work: _Work) -> _Tally:
    speed = velocity_error(work.scene, work.matches)
    yaw = yaw_error(work.scene, work.matches)
    flipped = yaw > np.pi / 2
    return _Tally(
        counts={
            "matches": len(work.matches),
            "velocity_error": float(speed.sum()),
            "velocity_square": float((speed**2).sum()),
            "yaw_error": float(yaw[~flipped].sum()),
            "upright": int((~flipped).sum()),
            "flips": int(flipped.sum()),
        },
        series={},
        parameters={"gate": work.parameters.gate},
    )


def _objects(work: _Work) -> _Tally:
    result = object_measures(work.scene, work.matches)
    counts = {
        key: Samples(value) if isinstance(value, np.ndarray) else value
        for key, value in vars(result).items()
    }
    return _Tally(counts=counts, series={}, parameters={"gate": work.parameters.gate})


def _occlusion(work: _Work) -> _Tally:
    p = work.parameters
    result = occlusion_measures(work.scene, work.matches, p.occlusion_frames)
    return _Tally(
        counts={**vars(result), "coasting_error": Samples(result.coasting_error)},
        series={},
        parameters={"gate": p.gate, "occlusion_frames": p.occlusion_frames},
    )


def _consistency(work: _Work) -> _Tally:
    scene, matches = work.scene, work.matches
    covariance = scene.tracks.covariance[matches.track]
    given = np.isfinite(covariance).all(axis=(1, 2))
    truth, track = matches.truth[given], matches.track[given]
    error = np.concatenate(
        [
            scene.tracks.position[track, :2] - scene.truth.position[truth, :2],
            scene.tracks.velocity[track] - scene.truth.velocity[truth],
        ],
        axis=1,
    )
    try:
        squares = normalised_squares(error, covariance[given])
    except InputError as problem:
        row = track[problem.rows[0]]
        where = {"frame": int(scene.tracks.frame[row]), "object_id": int(scene.tracks.id[row])}
        raise problem.located(**where) from None
    return _Tally(
        counts={
            "nees": float(squares.sum()),
            "estimates": len(squares),
            "run_nees": Samples(np.array([squares.sum()])),
            "run_estimates": Samples(np.array([float(len(squares))])),
        },
        series={},
        parameters={"gate": work.parameters.gate, "state": "x, y, vx, vy"},
    )


def _existence(work: _Work) -> _Tally:
    real = np.zeros(len(work.scene.tracks), np.bool_)
    real[work.matches.track] = True
    result = reliability(work.scene.tracks.score, real)
    return _Tally(
        counts={
            "reports": len(real),
            "count": result.count,
            "hits": result.hits,
            "probability_sum": result.probability_sum,
            "square_sum": result.square_sum,
        },
        series={},
        parameters={"gate": work.parameters.gate, "bins": len(result.count)},
    )


def _tgospa(work: _Work) -> _Tally:
    p = work.parameters
    result = tgospa(
        work.scene, cutoff=p.tgospa_cutoff, order=p.tgospa_order, switch=p.tgospa_switch
    )
    return _Tally(
        counts={key: value for key, value in vars(result).items() if key != "distance"},
        series={},
        parameters={
            "cutoff": p.tgospa_cutoff,
            "order": p.tgospa_order,
            "switch_cost": p.tgospa_switch,
            "distance": "xy",
        },
    )


def _siap(work: _Work) -> _Tally:
    gate = work.parameters.gate
    associations = siap_associations(work.scene, gate=gate)
    return _Tally(
        counts=asdict(siap_counts(work.scene, associations)),
        series={},
        parameters={"gate": gate, "distance": "xy", "confirm": 1, "end": 1},
    )


_GROUPS: Final[Mapping[str, Callable[[_Work], _Tally]]] = {
    "gospa": _gospa,
    "ospa": _ospa,
    "ospa2": _ospa2,
    "clear": _clear,
    "identity": _identity,
    "hota": _hota,
    "cardinality": _cardinality,
    "motion": _motion,
    "objects": _objects,
    "occlusion": _occlusion,
    "consistency": _consistency,
    "existence": _existence,
    "tgospa": _tgospa,
    "siap": _siap,
}
_FOLLOW_OBJECTS: Final = ("objects", "occlusion")
"""Groups that follow objects in and out of sight, and so are the same for either scope."""


def _framewise(work: _Work, series: Mapping[str, FloatArray], **parameters: Any) -> _Tally:
    """Sums over frames of per-frame series, and the number of frames."""
    return _Tally(
        counts={
            "frames": len(work.scene),
            **{key: float(values.sum()) for key, values in series.items()},
        },
        series=series,
        parameters=parameters,
    )
