"""The probabilistic Kalman filter tracker: covariances from statistics, Mahalanobis association.

Source: Chiu, Prioletti, Li and Bohg 2020, "Probabilistic 3D Multi-Object Tracking for Autonomous
Driving".
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from dataclasses import dataclass, field
from types import MappingProxyType
from typing import Any, Final

import numpy as np

from pmbm.baselines.association import greedy_mahalanobis
from pmbm.baselines.box_filter import (
    BOX,
    YAW,
    BoxNoise,
    fold_half_turns,
    measured_boxes,
)
from pmbm.baselines.lifecycle import BoxTracker, Lifecycle
from pmbm.errors import InputError, nearest_hint
from pmbm.geometry import wrap_angle
from pmbm.types import CLUTTER, Detections, FloatArray, Label, Recording, Tracks
from pmbm.validation import Checker

_STATES: Final = 11
_LEAST: Final = 30
"""Samples below which a label's statistics are not trusted."""


def _round_noise(
    *, box: float, yaw: float, size: float, speed: float, acceleration: float, turning: float
) -> BoxNoise:
    """Round standard deviations as variances: m, rad, and per frame at 10 Hz."""
    measured = np.array([box, box, 0.1, yaw, size, size / 2, 0.1]) ** 2
    rates = np.array([speed, speed, 0.05, 0.05]) ** 2
    changes = np.array([acceleration, acceleration, 0.02, turning]) ** 2
    return BoxNoise(
        initial=np.concatenate([measured, rates]),
        process=np.concatenate([changes, np.zeros(3), changes]),
        measurement=measured,
    )


_VEHICLE: Final = _round_noise(
    box=0.2, yaw=0.1, size=0.3, speed=1.0, acceleration=0.05, turning=0.02
)
_RIDER: Final = _round_noise(
    box=0.1, yaw=0.1, size=0.15, speed=0.5, acceleration=0.04, turning=0.05
)
_WALKER: Final = _round_noise(
    box=0.1, yaw=0.3, size=0.15, speed=0.15, acceleration=0.03, turning=0.1
)
DEFAULT_NOISE: Final[Mapping[Label, BoxNoise]] = MappingProxyType(
    dict.fromkeys(Label, _VEHICLE)
    | {Label.CYCLIST: _RIDER, Label.MOTORCYCLIST: _RIDER, Label.PEDESTRIAN: _WALKER}
)
"""Round numbers for where there are no statistics; `fit_statistics` gives better ones."""


@dataclass(frozen=True, eq=False, kw_only=True)
class ProbabilisticKFConfig:
    """Parameters of the probabilistic Kalman filter tracker.

    mahalanobis_gate : distances below it may associate.
    min_score : detections below it are not looked at.
    min_hits : detections in all before a track is reported.
    max_age : frames without a detection after which a track ends.
    report_above : a track is reported while its last detection scored at least this.
    frame_rate : frames per second in which ages and velocities are counted, Hz.
    noise : variances by label, with eleven states; labels left out have round numbers.  As a file
        has it, too: tables of `initial`, `process` and `measurement` by the label's name.
    """

    mahalanobis_gate: float = 11.0
    min_score: float = 0.0
    min_hits: int = 3
    max_age: float = 2.0
    report_above: float = 0.0
    frame_rate: float = 10.0
    noise: Mapping[Label, BoxNoise] | Mapping[str, Any] = field(default_factory=dict)

    def __post_init__(self) -> None:
        door = Checker(self, type(self).__name__)
        for name in ("min_score", "report_above"):
            door.number(name, at_least=0.0, at_most=1.0)
        door.count("min_hits", at_least=1)
        for name in ("mahalanobis_gate", "max_age", "frame_rate"):
            door.number(name, above=0.0)
        given = dict(_noise(label, noise) for label, noise in self.noise.items())
        object.__setattr__(self, "noise", MappingProxyType({**DEFAULT_NOISE, **given}))

    def noise_of(self, label: Label) -> BoxNoise:
        """The variances of a label."""
        noise: BoxNoise = self.noise[label]  # type: ignore[index]
        return noise

    def __reduce__(self) -> tuple[Any, ...]:
        # Mapping proxies do not pickle.
        values = {**self.__dict__, "noise": dict(self.noise)}
        return _make_config, (values,)


def _noise(label: Any, noise: Any) -> tuple[Label, BoxNoise]:
    """A label and its variances, from values or from their names."""
    names = [known.name for known in Label]
    name = label.name if isinstance(label, Label) else str(label)
    if name not in names:
        raise InputError(
            "no such label", field=f"noise.{name}", hint=nearest_hint(name, names, "label")
        )
    if isinstance(noise, Mapping):
        known = ("initial", "process", "measurement")
        for key in (*noise, *known):
            if key not in known or key not in noise:
                raise InputError(
                    "variances of a label",
                    field=f"noise.{name}.{key}",
                    expected=", ".join(known),
                    hint=nearest_hint(key, known, "key"),
                )
        noise = BoxNoise(**noise)
    if len(noise.initial) != _STATES:
        raise InputError(
            "the probabilistic Kalman filter has eleven states",
            field=f"noise.{name}",
            expected=_STATES,
            got=len(noise.initial),
        )
    return Label[name], noise


def _make_config(values: dict[str, Any]) -> ProbabilisticKFConfig:
    return ProbabilisticKFConfig(**values)


class ProbabilisticKFTracker:
    """The probabilistic Kalman filter behind the tracker protocol: class by class, eleven states,
    greedy association by Mahalanobis distance; a track is shown from its `min_hits`-th detection
    on, in frames that find it.  Its score is that of its last detection.
    """

    def __init__(self, config: ProbabilisticKFConfig | None = None) -> None:
        self.config = config = config or ProbabilisticKFConfig()
        self._boxes = BoxTracker(
            lifecycle=Lifecycle(
                min_score=config.min_score,
                min_hits=config.min_hits,
                max_age=config.max_age,
                coasting=False,
                report_above=config.report_above,
                frame_rate=config.frame_rate,
            ),
            noise=config.noise_of,
            associate=greedy_mahalanobis(config.mahalanobis_gate),
        )

    def step(self, detections: Detections, /) -> Tracks:
        """Advance by one frame's detections, and report.

        Raises InputError, the state untouched, where time runs backwards, and where tracks times
        detections of a label exceed `MOST_PAIRS`.
        """
        return self._boxes.step(detections)


def fit_statistics(
    recordings: Iterable[Recording], *, frame_rate: float = 10.0
) -> dict[Label, BoxNoise]:
    """The variances by label that `ProbabilisticKFConfig.noise` takes, from recordings with truth
    and known origins (Chiu et al. 2020, Sec. III, "covariance matrices estimation").

    R : mean square of detection minus truth, flips undone; P of a new track's box is the same.
    P of its velocities : mean square of the truth's change per frame.
    Q of x, y, z, yaw and of their velocities : mean square of that change's change; of the size: 0.

    Labels with fewer than 30 samples of any of these are left out.
    Raises InputError where a recording's origins are unknown.
    """
    errors, rates, changes = _nothing(), _nothing(), _nothing()
    for recording in recordings:
        for label, rows in _detection_errors(recording):
            errors[label].append(rows)
        for label, first, second in _motions(recording, frame_rate):
            rates[label].append(first)
            changes[label].append(second)
    fitted = {}
    for label in Label:
        if min(sum(map(len, group[label])) for group in (errors, rates, changes)) >= _LEAST:
            measured = np.maximum(_mean_square(errors[label]), 1e-6)
            change = _mean_square(changes[label])
            fitted[label] = BoxNoise(
                initial=np.concatenate([measured, np.maximum(_mean_square(rates[label]), 1e-6)]),
                process=np.concatenate([change, np.zeros(BOX - 4), change]),
                measurement=measured,
            )
    return fitted


def _detection_errors(recording: Recording) -> Iterable[tuple[Label, FloatArray]]:
    if recording.origin is None:
        raise InputError(
            f"recording '{recording.name}': the origin of its detections is unknown",
            field="origin",
            hint="give it matched ones, for example with pmbm.datasets.with_origins",
        )
    for detections, frame, origin in zip(
        recording.detections, recording.frame.tolist(), recording.origin, strict=True
    ):
        real = np.flatnonzero(origin != CLUTTER)
        truth = recording.truth[frame]
        true_boxes = measured_boxes(truth)[origin[real]]
        difference = measured_boxes(detections)[real] - true_boxes
        difference[:, YAW] = fold_half_turns(difference[:, YAW])
        for label in np.unique(truth.label[origin[real]]).tolist():
            yield Label(label), difference[truth.label[origin[real]] == label]


def _motions(
    recording: Recording, frame_rate: float
) -> Iterable[tuple[Label, FloatArray, FloatArray]]:
    """Per object and unbroken spell: its changes per frame (n,4), and their changes (n-1,4)."""
    spells: dict[int, list[tuple[float, FloatArray]]] = {}
    labels: dict[int, Label] = {}

    def finished(object_id: int) -> Iterable[tuple[Label, FloatArray, FloatArray]]:
        spell = spells.pop(object_id)
        frames = np.diff([time for time, _ in spell])[:, None] * frame_rate
        step = (
            np.diff([place for _, place in spell], axis=0) if len(spell) > 1 else np.zeros((0, 4))
        )
        step[:, YAW] = wrap_angle(step[:, YAW])
        rate = step / frames
        yield labels[object_id], rate, np.diff(rate, axis=0)

    for truth in recording.truth:
        present = truth.id.tolist()
        for gone in [object_id for object_id in spells if object_id not in set(present)]:
            yield from finished(gone)
        places = measured_boxes(truth)[:, : YAW + 1]
        for object_id, label, place in zip(present, truth.label.tolist(), places, strict=True):
            labels[object_id] = Label(label)
            spells.setdefault(object_id, []).append((truth.time, place))
    for object_id in list(spells):
        yield from finished(object_id)


def _nothing() -> dict[Label, list[FloatArray]]:
    return {label: [] for label in Label}


def _mean_square(samples: list[FloatArray]) -> FloatArray:
    return np.mean(np.concatenate(samples) ** 2, axis=0)
