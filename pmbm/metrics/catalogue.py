"""The metrics by name: what each answers, its unit, which way is better, and its formula."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping
from dataclasses import dataclass
from typing import Final

import numpy as np

from pmbm.errors import InputError, nearest_hint
from pmbm.metrics.consistency import chi2_bounds
from pmbm.metrics.result import OBSERVABLE, Counts, Definition, Undefined

Formula = Callable[[Counts], float | Undefined]
Parts = Callable[[Counts], Mapping[str, float]]

STATE_DIMENSION: Final = 4


@dataclass(frozen=True, kw_only=True)
class MetricParameters:
    """Cutoffs, orders and gates of the metrics; the defaults are those of the project's tables.

    gospa_cutoff, gospa_order : c in m, p (alpha is 2).
    ospa_cutoff, ospa_order : c in m, p; of OSPA and OSPA(2).
    ospa2_window : s.
    gate : centres strictly nearer than this in (x, y, z), m, may match (CLEAR, IDF1, testbed).
    similarity_zero : HOTA's similarity is max(0, 1 - d / similarity_zero), m.
    tgospa_cutoff, tgospa_order, tgospa_switch : c in m, p, gamma in m.
    occlusion_frames : shortest spell of unobservable frames that is an occlusion.
    """

    gospa_cutoff: float = 4.0
    gospa_order: float = 2.0
    ospa_cutoff: float = 10.0
    ospa_order: float = 2.0
    ospa2_window: float = 1.0
    gate: float = 2.0
    similarity_zero: float = 4.0
    tgospa_cutoff: float = 4.0
    tgospa_order: float = 2.0
    tgospa_switch: float = 2.0
    occlusion_frames: int = 5

    def __post_init__(self) -> None:
        for name, least in _LEAST.items():
            value = getattr(self, name)
            above = name not in _AT_LEAST
            if not (least < value < np.inf if above else least <= value < np.inf):
                raise InputError(
                    "bad metric parameter",
                    field=name,
                    expected=f"{'above' if above else 'at least'} {least:g}",
                    got=value,
                )


_AT_LEAST: Final = ("gospa_order", "ospa_order", "tgospa_order", "occlusion_frames")
_LEAST: Final = {
    "gospa_cutoff": 0.0,
    "gospa_order": 1.0,
    "ospa_cutoff": 0.0,
    "ospa_order": 1.0,
    "ospa2_window": 0.0,
    "gate": 0.0,
    "similarity_zero": 0.0,
    "tgospa_cutoff": 0.0,
    "tgospa_order": 1.0,
    "tgospa_switch": 0.0,
    "occlusion_frames": 1.0,
}


def ratio(top: str, bottom: str, none: str) -> Formula:
    """counts[top] / counts[bottom], undefined (with this reason) where the latter is 0."""

    def formula(counts: Counts) -> float | Undefined:
        return counts[top] / counts[bottom] if counts[bottom] else Undefined(none)

    return formula


def total(name: str) -> Formula:
    return lambda counts: float(counts[name])


def means(bottom: str, *names: str) -> Parts:
    """Further sums, each over counts[bottom]."""

    def parts(counts: Counts) -> Mapping[str, float]:
        return {name: float(counts[name] / counts[bottom]) for name in names if counts[bottom]}

    return parts


def median(name: str, none: str) -> Formula:
    def formula(counts: Counts) -> float | Undefined:
        values = counts[name].values
        return float(np.median(values)) if len(values) else Undefined(none)

    return formula


def mean(name: str, none: str) -> Formula:
    def formula(counts: Counts) -> float | Undefined:
        values = counts[name].values
        return float(values.mean()) if len(values) else Undefined(none)

    return formula


def described(name: str, *totals: str) -> Parts:
    """Mean, median and number of samples, and further totals."""

    def parts(counts: Counts) -> Mapping[str, float]:
        values = counts[name].values
        numbers = {"n": float(len(values)), **{key: float(counts[key]) for key in totals}}
        if len(values):
            numbers |= {"mean": float(values.mean()), "median": float(np.median(values))}
        return numbers

    return parts


def mota(counts: Counts) -> float | Undefined:
    """1 - (misses + false positives + switches) / truths."""
    if not counts["truths"]:
        return Undefined(_NO_TRUTH)
    errors = counts["misses"] + counts["false_positives"] + counts["switches"]
    return 1 - errors / counts["truths"]


def f1(true: str, missed: str, false: str) -> Formula:
    """2 true / (2 true + missed + false)."""

    def formula(counts: Counts) -> float | Undefined:
        rows = 2 * counts[true] + counts[missed] + counts[false]
        return 2 * counts[true] / rows if rows else Undefined("no truth and no tracks")

    return formula


def over_alphas(curve: Callable[[Counts], np.ndarray]) -> Formula:
    """The mean of a curve over HOTA's thresholds."""

    def formula(counts: Counts) -> float | Undefined:
        rows = counts["true_positives"] + counts["misses"] + counts["false_positives"]
        return float(curve(counts).mean()) if rows.any() else Undefined("no truth and no tracks")

    return formula


def deta_curve(counts: Counts) -> np.ndarray:
    """DetA at each threshold, (A,)."""
    rows = counts["true_positives"] + counts["misses"] + counts["false_positives"]
    return counts["true_positives"] / np.maximum(1, rows)


def assa_curve(counts: Counts) -> np.ndarray:
    """AssA at each threshold, (A,); 0 where nothing matches."""
    return counts["association"] / np.maximum(1, counts["true_positives"])


def loca_curve(counts: Counts) -> np.ndarray:
    """LocA at each threshold, (A,); 1 where nothing matches."""
    hits = counts["true_positives"]
    return np.where(hits > 0, counts["similarity"] / np.maximum(1, hits), 1.0)


def hota_curve(counts: Counts) -> np.ndarray:
    """HOTA at each threshold, (A,)."""
    return np.sqrt(deta_curve(counts) * assa_curve(counts))


def _speed_parts(counts: Counts) -> Mapping[str, float]:
    if not counts["matches"]:
        return {}
    return {"root_mean_square": float(np.sqrt(counts["velocity_square"] / counts["matches"]))}


def _kept_share(counts: Counts) -> float | Undefined:
    occlusions = counts["kept"] + counts["lost"]
    return counts["kept"] / occlusions if occlusions else Undefined("no tracked object was hidden")


def _nees_parts(counts: Counts) -> Mapping[str, float]:
    if not counts["estimates"]:
        return {}
    low, high = chi2_bounds(STATE_DIMENSION, counts["estimates"])
    return {"n": float(counts["estimates"]), "low": low, "high": high}


def _anees_parts(counts: Counts) -> Mapping[str, float]:
    return {
        key: value if key == "n" else value / STATE_DIMENSION
        for key, value in _nees_parts(counts).items()
    }


def _calibration_error(counts: Counts) -> float | Undefined:
    if not counts["reports"]:
        return Undefined(_NO_TRACKS)
    return float(np.abs(counts["probability_sum"] - counts["hits"]).sum() / counts["reports"])


_PARTS: Final = ("localisation", "missed", "false", "switch")
_NO_FRAMES: Final = "no frames"
_NO_TRUTH: Final = "no truth"
_NO_TRACKS: Final = "no tracks"
_NO_MATCH: Final = "nothing is matched"
_NO_OBJECT: Final = "no object is matched"

_DEFINITIONS: Final = (
    Definition(
        name="gospa", group="gospa", unit="m", direction="lower", series="distance",
        answers="How far is the picture from the truth, all errors in one number?",
        formula=ratio("distance", "frames", _NO_FRAMES),
        parts=means("frames", "localisation", "missed", "false", "missed_count", "false_count"),
    ),
    Definition(
        name="gospa_localisation", group="gospa", unit="m^p", direction="lower",
        series="localisation", answers="How much of it is misplacement?",
        formula=ratio("localisation", "frames", _NO_FRAMES),
    ),
    Definition(
        name="gospa_missed", group="gospa", unit="m^p", direction="lower", series="missed",
        answers="How much of it is missed objects?",
        formula=ratio("missed", "frames", _NO_FRAMES),
    ),
    Definition(
        name="gospa_false", group="gospa", unit="m^p", direction="lower", series="false",
        answers="How much of it is false tracks?",
        formula=ratio("false", "frames", _NO_FRAMES),
    ),
    Definition(
        name="ospa", group="ospa", unit="m", direction="lower", series="distance",
        answers="How far off is the picture, per object?",
        formula=ratio("distance", "frames", _NO_FRAMES),
        parts=means("frames", "localisation", "cardinality"),
    ),
    Definition(
        name="ospa_localisation", group="ospa", unit="m", direction="lower",
        series="localisation", answers="How much of it is misplacement?",
        formula=ratio("localisation", "frames", _NO_FRAMES),
    ),
    Definition(
        name="ospa_cardinality", group="ospa", unit="m", direction="lower", series="cardinality",
        answers="How much of it is a wrong number of objects?",
        formula=ratio("cardinality", "frames", _NO_FRAMES),
    ),
    Definition(
        name="ospa2", group="ospa2", unit="m", direction="lower", series="distance",
        answers="How far off are the tracks of the last second, identities included?",
        formula=ratio("distance", "frames", _NO_FRAMES),
        parts=means("frames", "localisation", "cardinality"),
    ),
    Definition(
        name="mota", group="clear", variant="clear", unit="1", direction="higher",
        answers="What share of objects is found, less false boxes and identity switches?",
        formula=mota,
    ),
    Definition(
        name="motp", group="clear", variant="clear", unit="m", direction="lower",
        answers="How far is a matched box from its object?",
        formula=ratio("distance_sum", "matches", _NO_MATCH),
    ),
    Definition(
        name="id_switches", group="clear", variant="clear", unit="events", direction="lower",
        answers="How often does an object change its track id?", formula=total("switches"),
    ),
    Definition(
        name="false_positives", group="clear", variant="clear", unit="boxes", direction="lower",
        answers="How many reported boxes are nothing?", formula=total("false_positives"),
    ),
    Definition(
        name="misses", group="clear", variant="clear", unit="boxes", direction="lower",
        answers="How many true boxes are not reported?", formula=total("misses"),
    ),
    Definition(
        name="fragmentations", group="clear", variant="clear", unit="events", direction="lower",
        answers="How often is a track interrupted?", formula=total("fragmentations"),
    ),
    Definition(
        name="precision", group="clear", variant="clear", unit="1", direction="higher",
        answers="What share of reported boxes is real?",
        formula=ratio("matches", "tracks", _NO_TRACKS),
    ),
    Definition(
        name="recall", group="clear", variant="clear", unit="1", direction="higher",
        answers="What share of true boxes is reported?",
        formula=ratio("matches", "truths", _NO_TRUTH),
    ),
    Definition(
        name="mostly_tracked", group="clear", variant="clear", unit="1", direction="higher",
        answers="What share of objects is tracked for at least 80 % of its life?",
        formula=ratio("mostly_tracked", "objects", _NO_TRUTH),
    ),
    Definition(
        name="mostly_lost", group="clear", variant="clear", unit="1", direction="lower",
        answers="What share of objects is tracked for less than 20 % of its life?",
        formula=ratio("mostly_lost", "objects", _NO_TRUTH),
    ),
    Definition(
        name="idf1", group="identity", unit="1", direction="higher",
        answers="For how long does one track id stay with one object?",
        formula=f1("true_positives", "misses", "false_positives"),
    ),
    Definition(
        name="hota", group="hota", unit="1", direction="higher",
        answers="How good are detection and association together, in equal parts?",
        formula=over_alphas(hota_curve),
    ),
    Definition(
        name="deta", group="hota", unit="1", direction="higher",
        answers="How good is detection alone?", formula=over_alphas(deta_curve),
    ),
    Definition(
        name="assa", group="hota", unit="1", direction="higher",
        answers="How good is association alone?", formula=over_alphas(assa_curve),
    ),
    Definition(
        name="loca", group="hota", unit="1", direction="higher",
        answers="How well placed are matched boxes?", formula=over_alphas(loca_curve),
    ),
    Definition(
        name="cardinality_error", group="cardinality", unit="objects", direction="none",
        series="error", answers="Are too many or too few objects reported (reported minus true)?",
        formula=ratio("error", "frames", _NO_FRAMES),
    ),
    Definition(
        name="cardinality_error_absolute", group="cardinality", unit="objects",
        direction="lower", series="absolute", answers="By how many objects is the count wrong?",
        formula=ratio("absolute", "frames", _NO_FRAMES),
    ),
    Definition(
        name="velocity_error", group="motion", unit="m/s", direction="lower",
        answers="How wrong is the velocity of matched objects?",
        formula=ratio("velocity_error", "matches", _NO_MATCH),
        parts=_speed_parts,
    ),
    Definition(
        name="yaw_error", group="motion", unit="rad", direction="lower",
        answers="How wrong is the heading of matched objects that are not flipped?",
        formula=ratio("yaw_error", "upright", "no matched object without a flipped heading"),
    ),
    Definition(
        name="yaw_flips", group="motion", unit="1", direction="lower",
        answers="What share of matched objects points backwards (yaw off by more than 90 degrees)?",
        formula=ratio("flips", "matches", _NO_MATCH),
    ),
    Definition(
        name="initiation_delay", group="objects", unit="s", direction="lower",
        answers="How long until a visible object is first tracked (median)?",
        formula=median("initiation_delay", "no visible object is ever matched"),
        parts=described("initiation_delay", "never_initiated"),
    ),
    Definition(
        name="ghost_time", group="objects", unit="s", direction="lower",
        answers="How long does a track outlive its object (mean)?",
        formula=mean("ghost_time", _NO_OBJECT),
        parts=described("ghost_time", "never_matched"),
    ),
    Definition(
        name="track_life", group="objects", unit="1", direction="higher",
        answers="For what share of its visible life is an object tracked (mean)?",
        formula=mean("track_life", "no object is ever observable"),
        parts=described("track_life", "never_observable"),
    ),
    Definition(
        name="false_tracks", group="objects", unit="tracks", direction="lower",
        answers="How many track ids never match any object?",
        formula=lambda counts: float(len(counts["false_track_life"].values)),
        parts=lambda counts: {"life": float(counts["false_track_life"].values.sum())},
    ),
    Definition(
        name="id_kept", group="occlusion", unit="1", direction="higher",
        answers="In what share of occlusions does the object come back under its old id?",
        formula=_kept_share,
        parts=lambda counts: {key: float(counts[key]) for key in ("kept", "lost", "untracked")},
    ),
    Definition(
        name="coasting_error", group="occlusion", unit="m", direction="lower",
        answers="How far from the hidden object is its track?",
        formula=mean("coasting_error", "no track is reported for a hidden object"),
        parts=described("coasting_error", "hidden"),
    ),
    Definition(
        name="nees", group="consistency", unit="1", direction="none",
        answers="Is the reported covariance honest (4 for the state x, y, vx, vy)?",
        formula=ratio("nees", "estimates", "no matched track has a covariance"),
        parts=_nees_parts,
    ),
    Definition(
        name="anees", group="consistency", unit="1", direction="none",
        answers="Is the reported covariance honest (1; above: too sure of itself)?",
        formula=lambda counts: (
            counts["nees"] / counts["estimates"] / STATE_DIMENSION
            if counts["estimates"]
            else Undefined("no matched track has a covariance")
        ),
        parts=_anees_parts,
    ),
    Definition(
        name="existence_brier", group="existence", unit="1", direction="lower", default=False,
        answers="How good is the reported probability of existence (mean squared error)?",
        formula=ratio("square_sum", "reports", _NO_TRACKS),
    ),
    Definition(
        name="existence_calibration_error", group="existence", unit="1", direction="lower",
        default=False, answers="How far is the reported probability from the share that is real?",
        formula=_calibration_error,
    ),
    Definition(
        name="tgospa", group="tgospa", unit="m", direction="lower", default=False,
        answers="How far are whole trajectories off, switches of identity included?",
        formula=lambda counts: sum(counts[part] for part in _PARTS) ** (1 / counts["order"]),
        parts=lambda counts: {part: float(counts[part]) for part in _PARTS},
    ),
    Definition(
        name="siap_completeness", group="siap", unit="1", direction="higher", default=False,
        answers="What share of objects has a track?",
        formula=ratio("tracked", "truths", _NO_TRUTH),
    ),
    Definition(
        name="siap_ambiguity", group="siap", unit="1", direction="lower", default=False,
        answers="How many tracks has a tracked object (1 is best)?",
        formula=ratio("associated", "tracked", _NO_MATCH),
    ),
    Definition(
        name="siap_spuriousness", group="siap", unit="1", direction="lower", default=False,
        answers="What share of tracks follows nothing?",
        formula=lambda counts: (
            (counts["tracks"] - counts["associated"]) / counts["tracks"]
            if counts["tracks"]
            else Undefined(_NO_TRACKS)
        ),
    ),
    Definition(
        name="siap_position_accuracy", group="siap", unit="m", direction="lower", default=False,
        answers="How far is a track from its object?",
        formula=ratio("position_error", "associated", _NO_MATCH),
    ),
    Definition(
        name="siap_velocity_accuracy", group="siap", unit="m/s", direction="lower",
        default=False, answers="How wrong is a track's velocity?",
        formula=ratio("velocity_error", "associated", _NO_MATCH),
    ),
    Definition(
        name="siap_track_changes", group="siap", unit="1/s", direction="lower", default=False,
        answers="How often does an object change its track, per time tracked?",
        formula=ratio("track_changes", "time_tracked", _NO_MATCH),
    ),
    Definition(
        name="siap_longest_segment", group="siap", unit="1", direction="higher", default=False,
        answers="What share of its life is an object's longest track?",
        formula=ratio("longest_segment", "lifetime", "no object lives for two frames"),
    ),
)  # fmt: skip

_BY_NAME: Final = {entry.name: entry for entry in _DEFINITIONS}

DEFAULT_METRICS: Final = tuple(
    name
    for entry in _DEFINITIONS
    if entry.default
    for name in (entry.name, entry.name + OBSERVABLE)
)
"""What `evaluate` gives unless told otherwise."""


def definition(name: str) -> Definition:
    """The definition behind a name; InputError, with the nearest valid name, where there is none.

    A name may end in "_observable".
    """
    entry = _BY_NAME.get(name.removesuffix(OBSERVABLE))
    if entry is None:
        raise InputError(f"no metric '{name}'", hint=nearest_hint(name, names(), "metric"))
    return entry


def names() -> Iterable[str]:
    """Every name that `evaluate` knows."""
    return [name + suffix for suffix in ("", OBSERVABLE) for name in _BY_NAME]
