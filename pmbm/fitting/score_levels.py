"""Score levels from recordings whose detections' origins are known.

In three steps: the plain tracker tells which detections came from one source; a logistic
regression says what a score at a range is worth; and the sources' levels, which no one sees, are
told apart by expectation-maximisation, together with how probably each level is an object's.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np

from pmbm.errors import InputError
from pmbm.filter.config import PMBMConfig
from pmbm.filter.density import MISSED
from pmbm.filter.estimation import marginals
from pmbm.filter.models.protocols import SceneDensity
from pmbm.filter.models.score_levels import ScoreLevels
from pmbm.filter.models.scores import IgnoreScores
from pmbm.filter.tracker import PMBMTracker
from pmbm.score import Calibration, logistic
from pmbm.types import CLUTTER, BoolArray, FloatArray, IntArray, Label, Recording

_LEVELS = 24
_NEVER = -50.0
"""Log-odds of what nobody has a model of."""
_ROUNDS = 60
_WORTH = 10
"""Detections up to which a source counts in proportion to them: a second's at 10 Hz."""
_FEWEST = 1.0
"""Seconds of looking, and of objects seen, that recordings are taken to hold at least."""
_LASTING = 2
"""Detections from which a source is no chance clutter."""
_BIRTH_AT = np.arange(5.0, 80.0, 10.0)
"""m from the sensor at which the levels of new sources are told apart."""
_BESIDE = 8.0
"""m, the standard deviation within which sources say something of such a distance."""
_ANYWHERE = 2.0
"""Sources of any distance that those of one distance are held to."""
_MANY = 100
"""Objects from which on it shows where they come into view."""


@dataclass(frozen=True, eq=False)
class Sources:
    """The detections of one label in a recording, by the source that the tracker gave them to.

    source (N,) : number of the source.  object (N,) : whether the source is an object: more of its
    detections came from one than not.  score (N,) raw; range (N,) : m; row (N,) : of the detection
    among all that the recording has, in order.
    """

    source: IntArray
    object: BoolArray
    score: FloatArray
    range: FloatArray
    row: IntArray

    def __len__(self) -> int:
        return len(self.source)


def sources(
    recording: Recording,
    label: Label,
    config: PMBMConfig,
    unjudged: Sequence[BoolArray] | None = None,
) -> Sources:
    """Who is behind each detection of a label, as the tracker without marks sees it.

    config : of the tracker; what it says of scores is left aside.
    unjudged : of every frame, the detections of which the labels say neither that they are true nor
        that they are not; a source that most of its detections are such of is left out.

    Raises InputError for recordings without origins or raw scores.
    """
    if recording.origin is None:
        raise InputError(
            "marks are fitted to detections of known origin",
            field="origin",
            hint="pmbm.datasets.with_origins pairs a real recording's detections with its labels",
        )
    # Nothing is held back from the reports, so that no track goes by another's id.
    plain = replace(
        config,
        scores=IgnoreScores(),
        report=replace(config.report, above=0.0, exclusive=False),
    )
    tracker = PMBMTracker(plain, recording.site)
    found: list[tuple[int, bool, bool, float, float, int]] = []
    before = 0
    if unjudged is None:
        unjudged = [np.zeros(len(frame), bool) for frame in recording.detections]
    frames = zip(recording.detections, recording.origin, unjudged, strict=True)
    for detections, origin, open_question in frames:
        rows = np.flatnonzero(detections.label == label)
        own = detections.take(rows)
        if own.raw_score is None:
            raise InputError("levels are fitted to raw scores", field="raw_score")
        tracker.step(own)
        density = tracker.density
        assert density is not None
        best = marginals(density).best
        taken = density.local.history[best, -1]
        away = own.distance
        for track in np.flatnonzero(taken > MISSED).tolist():
            one = int(taken[track])
            hit = bool(origin[rows[one]] != CLUTTER)
            known = hit or not open_question[rows[one]]
            where = before + int(rows[one])
            who = int(density.track_id[track])
            found.append((who, hit, known, own.raw_score[one], away[one], where))
        before += len(detections)
    if not found:
        none, nobody = np.zeros(0), np.zeros(0, np.int64)
        return Sources(nobody, none.astype(bool), none, none, nobody)
    name, true, judged, score, away, row = (np.array(c) for c in zip(*found, strict=True))
    source = np.unique(name, return_inverse=True)[1]
    kept = (np.bincount(source, judged) >= 0.5 * np.bincount(source))[source]
    source = np.unique(source[kept], return_inverse=True)[1]
    share = np.bincount(source, true[kept]) / np.maximum(np.bincount(source, judged[kept]), 1)
    return Sources(source, (share > 0.5)[source], score[kept], away[kept], row[kept])


def fit_marks(
    recordings: Sequence[Recording],
    groups: Sequence[Sequence[Label]],
    configs: Mapping[Label, PMBMConfig],
    unjudged: Sequence[Sequence[BoolArray]] | None = None,
) -> dict[Label, ScoreLevels]:
    """The levels of every label, from recordings with origins.

    groups : labels that share one calibration and one set of levels, for what is seldom seen.
    configs : of each label's tracker, which tells the sources apart.
    unjudged : for every recording, as `sources` takes it.

    Raises InputError for recordings without origins or raw scores, and where a group has no
    objects.
    """
    open_questions = unjudged if unjudged is not None else [None] * len(recordings)
    found = {
        label: [
            sources(recording, label, configs[label], which)
            for recording, which in zip(recordings, open_questions, strict=True)
        ]
        for group in groups
        for label in group
    }
    # Where there is no model of a label, its detections are nobody's rivals.
    offset, slope, per_metre = (
        np.full(len(Label), _NEVER),
        np.zeros(len(Label)),
        np.zeros(len(Label)),
    )
    near, far = Calibration.near, Calibration.far
    for group in groups:
        parts = [part for label in group for part in found[label]]
        count = np.concatenate([np.bincount(part.source)[part.source] for part in parts])
        weight = np.minimum(1.0, _WORTH / np.maximum(count, 1)) * (count >= _LASTING)
        members = np.array(group, int)
        offset[members], slope[members], per_metre[members] = fit_log_odds(
            np.concatenate([part.score for part in parts]),
            np.concatenate([part.range for part in parts]).clip(near, far),
            np.concatenate([part.object for part in parts]),
            weight,
        )
    calibration = Calibration(offset=offset, slope=slope, per_metre=per_metre)
    log_odds = [
        np.concatenate([calibration.log_odds(frame) for frame in recording.detections])
        for recording in recordings
    ]
    levels = {}
    for group in groups:
        told = {label: _told(found[label], log_odds, recordings) for label in group}
        fitted = fit_levels(
            [one for each in told.values() for one in each.log_odds],
            np.concatenate([each.object for each in told.values()]),
            group[0],
            calibration,
            np.concatenate([each.abundance for each in told.values()]),
            np.concatenate([each.first for each in told.values()]),
        )
        for label, each in told.items():
            levels[Label(label)] = replace(fitted, label=int(label), mean_objects=each.mean_objects)
    return levels


@dataclass(frozen=True, eq=False)
class _Told:
    """S sources of a label: the log-odds (n,) of each one's detections, whether it is an object
    (S,), the abundance (S,) of others around it, in `mean_objects`, and the distance (S,)
    of its first detection."""

    log_odds: Sequence[FloatArray]
    object: BoolArray
    abundance: FloatArray
    first: FloatArray
    mean_objects: float


def _told(
    found: Sequence[Sources], log_odds: Sequence[FloatArray], recordings: Sequence[Recording]
) -> _Told:
    """What the detections of one label say, source by source."""
    seconds = np.array([one.detections[-1].time - one.detections[0].time for one in recordings])
    each = seconds / [len(one.detections) for one in recordings]
    shown = each * [part.object.sum() for part in found]
    mean_objects = float(max(shown.sum(), _FEWEST) / max(seconds.sum(), _FEWEST))
    said, real, abundance, first = [], [], [], []
    for k, (part, values) in enumerate(zip(found, log_odds, strict=True)):
        for one in range(int(part.source.max(initial=-1)) + 1):
            rows = np.flatnonzero(part.source == one)
            said.append(values[part.row[rows]])
            real.append(bool(part.object[rows[0]]))
            first.append(part.range[rows[0]])
            others = SceneDensity(seconds[k], shown[k] - real[-1] * len(rows) * each[k])
            abundance.append(others.abundance(mean_objects, ScoreLevels.prior_seconds))
    return _Told(said, np.array(real, bool), np.array(abundance), np.array(first), mean_objects)


def fit_log_odds(
    score: FloatArray, away: FloatArray, true: BoolArray, weight: FloatArray
) -> tuple[float, float, float]:
    """Offset, slope and per metre of a logistic regression over raw score and range, (N,) each."""
    design = np.column_stack([np.ones(len(score)), score, away])
    scale = np.array([1.0, 1.0, 0.1])
    found = _logistic_fit(design * scale, weight * true, weight) * scale
    return float(found[0]), float(found[1]), float(found[2])


def fit_levels(
    log_odds: Sequence[FloatArray],
    is_object: BoolArray,
    label: Label,
    calibration: Calibration,
    abundance: FloatArray | None = None,
    first: FloatArray | None = None,
) -> ScoreLevels:
    """The levels of S sources, each with the log-odds (n,) of its detections, by
    expectation-maximisation.

    abundance (S,) : of the objects around each source, in those that are usual.
    first (S,) : m from the sensor, of each source's first detection; None, or fewer than a hundred
        objects: births are the same at any distance.

    Scatter is that within the sources.  P(object | level) is a logistic curve.  Sources of a single
    detection that are no objects tell what clutter looks like.

    Raises InputError where there are no objects, or nothing but objects.
    """
    count = np.array([len(one) for one in log_odds])
    mean = np.array([one.mean() for one in log_odds])
    y = np.asarray(is_object, bool)
    lasts = count >= _LASTING
    if not (y & lasts).any() or (y | ~lasts).all():
        raise InputError("fitting levels", field="is_object", expected="objects and others")
    within = sum(float(((one - one.mean()) ** 2).sum()) for one in log_odds)
    variance = within / max(1, int((count - 1).sum()))
    low, high = np.quantile(mean[lasts], [0.005, 0.995])
    level = np.linspace(low - 0.5, high + 0.5, _LEVELS)
    fit = -0.5 * count[:, None] * (mean[:, None] - level) ** 2 / variance

    worth = np.minimum(count[lasts], _WORTH) / _WORTH
    birth = np.full(_LEVELS, 1 / _LEVELS)
    design = np.column_stack([np.ones(_LEVELS), level])
    weight = np.array([0.0, 1.0])
    around = np.zeros(len(count)) if abundance is None else np.log(abundance)
    # Sources among equally many objects are one scene; rows of a scene and a level are counted.
    scenes, scene = np.unique(around[lasts], return_inverse=True)
    rows, shift = np.tile(design, (len(scenes), 1)), np.repeat(scenes, _LEVELS)
    for _ in range(_ROUNDS):
        real = logistic(design @ weight + around[lasts, None])
        said = np.where(y[lasts, None], real, 1 - real).clip(1e-12)
        each = _normalised(fit[lasts] + np.log(birth) + np.log(said))
        birth = _shares(each.sum(axis=0))
        positive, total = np.zeros((2, len(scenes), _LEVELS))
        np.add.at(total, scene, each * worth[:, None])
        np.add.at(positive, scene, each * (worth * y[lasts])[:, None])
        weight = _logistic_fit(rows, positive.ravel(), total.ravel(), weight, shift)
    birth_at = None
    if first is not None and y[lasts].sum() >= _MANY:
        birth_at, anywhere = _BIRTH_AT, birth
        birth = np.empty((len(birth_at), _LEVELS))
        for row, away in enumerate(birth_at):
            near = np.exp(-0.5 * ((first[lasts] - away) / _BESIDE) ** 2)
            birth[row] = anywhere
            for _ in range(_ROUNDS):
                each = near @ _normalised(fit[lasts] + np.log(birth[row]) + np.log(said))
                birth[row] = _shares(each + _ANYWHERE * anywhere)
    clutter = np.full(_LEVELS, 1 / _LEVELS)
    alone = fit[~lasts & ~y]
    for _ in range(_ROUNDS if len(alone) else 0):
        clutter = _shares(_normalised(alone + np.log(clutter)).sum(axis=0))
    return ScoreLevels(
        label=int(label),
        calibration=calibration,
        level=level,
        scatter=float(np.sqrt(variance)),
        birth=birth,
        birth_at=birth_at,
        object=logistic(design @ weight),
        clutter=clutter,
    )


def _shares(total: FloatArray) -> FloatArray:
    """Shares of levels from how many sources have each; none is ruled out by few sources."""
    padded = total + 0.05
    return padded / padded.sum()


def _normalised(log_weight: FloatArray) -> FloatArray:
    weight = np.exp(log_weight - log_weight.max(axis=1, keepdims=True))
    return weight / weight.sum(axis=1, keepdims=True)


def _logistic_fit(
    design: FloatArray,
    positive: FloatArray,
    total: FloatArray,
    start: FloatArray | None = None,
    shift: FloatArray | float = 0.0,
) -> FloatArray:
    """Weights of a logistic regression of shares `positive` / `total` of rows, whose log-odds are
    shifted by what is known, by Newton's method, held a little to flat slopes so that rows told
    apart perfectly have an answer."""
    weight = np.zeros(design.shape[1]) if start is None else start
    ridge = 1e-2 * np.eye(design.shape[1])
    for _ in range(100):
        q = logistic(design @ weight + shift)
        curvature = design.T @ (design * (total * q * (1 - q))[:, None]) + ridge
        step = np.linalg.solve(curvature, design.T @ (positive - total * q) - ridge @ weight)
        weight = weight + np.clip(step, -2, 2)
        if np.abs(step).max() < 1e-9:
            break
    return weight
