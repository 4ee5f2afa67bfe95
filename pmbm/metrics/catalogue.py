"""The metrics by name: what each answers, its unit, which way is better, and its formula."""

from __future__ import annotations

from collections.abc import Iterable
from typing import Final

from pmbm.errors import InputError, nearest_hint
from pmbm.intervals import SHARE, Scale
from pmbm.metrics.formulas import (
    NO_FRAMES,
    NO_MATCH,
    NO_TRACKS,
    NO_TRUTH,
    STATE_DIMENSION,
    TGOSPA_PARTS,
    anees_parts,
    assa_curve,
    calibration_error,
    described,
    deta_curve,
    f1,
    hota_curve,
    kept_share,
    loca_curve,
    mean,
    means,
    median,
    mota,
    nees_parts,
    over_alphas,
    ratio,
    speed_parts,
    total,
)
from pmbm.metrics.parameters import MetricParameters
from pmbm.metrics.result import OBSERVABLE, Definition, Undefined

OSPA: Final = Scale(0.0, MetricParameters().ospa_cutoff)

_DEFINITIONS: Final = (
    Definition(
        name="gospa", group="gospa", unit="m", direction="lower", series="distance",
        answers="How far is the picture from the truth, all errors in one number?",
        formula=ratio("distance", "frames", NO_FRAMES),
        parts=means("frames", "localisation", "missed", "false", "missed_count", "false_count"),
    ),
    Definition(
        name="gospa_localisation", group="gospa", unit="m^p", direction="lower",
        series="localisation", answers="How much of GOSPA^p is misplacement?",
        formula=ratio("localisation", "frames", NO_FRAMES),
    ),
    Definition(
        name="gospa_missed", group="gospa", unit="m^p", direction="lower", series="missed",
        answers="How much of GOSPA^p is missed objects?",
        formula=ratio("missed", "frames", NO_FRAMES),
    ),
    Definition(
        name="gospa_false", group="gospa", unit="m^p", direction="lower", series="false",
        answers="How much of GOSPA^p is false tracks?",
        formula=ratio("false", "frames", NO_FRAMES),
    ),
    Definition(
        name="ospa", group="ospa", unit="m", direction="lower", series="distance",
        measured=OSPA,
        answers="How far off is the picture, per object?",
        formula=ratio("distance", "frames", NO_FRAMES),
        parts=means("frames", "localisation", "cardinality"),
    ),
    Definition(
        name="ospa_localisation", group="ospa", unit="m", direction="lower",
        measured=OSPA,
        series="localisation", answers="How much of OSPA is misplacement?",
        formula=ratio("localisation", "frames", NO_FRAMES),
    ),
    Definition(
        name="ospa_cardinality", group="ospa", unit="m", direction="lower", series="cardinality",
        measured=OSPA,
        answers="How much of OSPA is a wrong number of objects?",
        formula=ratio("cardinality", "frames", NO_FRAMES),
    ),
    Definition(
        name="ospa2", group="ospa2", unit="m", direction="lower", series="distance",
        measured=OSPA,
        answers="How far off are the tracks of the last second, identities included?",
        formula=ratio("distance", "frames", NO_FRAMES),
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
        formula=ratio("distance_sum", "matches", NO_MATCH),
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
        measured=SHARE,
        answers="What share of reported boxes is real?",
        formula=ratio("matches", "tracks", NO_TRACKS),
    ),
    Definition(
        name="recall", group="clear", variant="clear", unit="1", direction="higher",
        measured=SHARE,
        answers="What share of true boxes is reported?",
        formula=ratio("matches", "truths", NO_TRUTH),
    ),
    Definition(
        name="mostly_tracked", group="clear", variant="clear", unit="1", direction="higher",
        measured=SHARE,
        answers="What share of objects is tracked for at least 80 % of its life?",
        formula=ratio("mostly_tracked", "objects", NO_TRUTH),
    ),
    Definition(
        name="mostly_lost", group="clear", variant="clear", unit="1", direction="lower",
        measured=SHARE,
        answers="What share of objects is tracked for less than 20 % of its life?",
        formula=ratio("mostly_lost", "objects", NO_TRUTH),
    ),
    Definition(
        name="idf1", group="identity", unit="1", direction="higher",
        measured=SHARE,
        answers="For how long does one track id stay with one object?",
        formula=f1("true_positives", "misses", "false_positives"),
    ),
    Definition(
        name="hota", group="hota", unit="1", direction="higher",
        measured=SHARE,
        answers="How good are detection and association together, in equal parts?",
        formula=over_alphas(hota_curve),
    ),
    Definition(
        name="deta", group="hota", unit="1", direction="higher",
        measured=SHARE,
        answers="How good is detection alone?", formula=over_alphas(deta_curve),
    ),
    Definition(
        name="assa", group="hota", unit="1", direction="higher",
        measured=SHARE,
        answers="How good is association alone?", formula=over_alphas(assa_curve),
    ),
    Definition(
        name="loca", group="hota", unit="1", direction="higher",
        measured=SHARE,
        answers="How well placed are matched boxes?", formula=over_alphas(loca_curve),
    ),
    Definition(
        name="cardinality_error", group="cardinality", unit="objects", direction="none",
        series="error", answers="Are too many or too few objects reported (reported minus true)?",
        formula=ratio("error", "frames", NO_FRAMES),
    ),
    Definition(
        name="cardinality_error_absolute", group="cardinality", unit="objects",
        direction="lower", series="absolute", answers="By how many objects is the count wrong?",
        formula=ratio("absolute", "frames", NO_FRAMES),
    ),
    Definition(
        name="velocity_error", group="motion", unit="m/s", direction="lower",
        answers="How wrong is the velocity of matched objects?",
        formula=ratio("velocity_error", "matches", NO_MATCH),
        parts=speed_parts,
    ),
    Definition(
        name="yaw_error", group="motion", unit="rad", direction="lower",
        answers="How wrong is the heading of matched objects that are not flipped?",
        formula=ratio("yaw_error", "upright", "no matched object without a flipped heading"),
    ),
    Definition(
        name="yaw_flips", group="motion", unit="1", direction="lower",
        measured=SHARE,
        answers="What share of matched objects points backwards (yaw off by more than 90 degrees)?",
        formula=ratio("flips", "matches", NO_MATCH),
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
        formula=mean("ghost_time", "no object is matched"),
        parts=described("ghost_time", "never_matched"),
    ),
    Definition(
        name="track_life", group="objects", unit="1", direction="higher",
        measured=SHARE,
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
        measured=SHARE,
        answers="In what share of occlusions does the object come back under its old id?",
        formula=kept_share,
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
        parts=nees_parts,
    ),
    Definition(
        name="anees", group="consistency", unit="1", direction="none",
        answers="Is the reported covariance honest (1; above: too sure of itself)?",
        formula=lambda counts: (
            counts["nees"] / counts["estimates"] / STATE_DIMENSION
            if counts["estimates"]
            else Undefined("no matched track has a covariance")
        ),
        parts=anees_parts,
    ),
    Definition(
        name="existence_brier", group="existence", unit="1", direction="lower", default=False,
        measured=SHARE,
        answers="How good is the reported probability of existence (mean squared error)?",
        formula=ratio("square_sum", "reports", NO_TRACKS),
    ),
    Definition(
        name="existence_calibration_error", group="existence", unit="1", direction="lower",
        measured=SHARE,
        default=False, answers="How far is the reported probability from the share that is real?",
        formula=calibration_error,
    ),
    Definition(
        name="tgospa", group="tgospa", unit="m", direction="lower", default=False,
        answers="How far are whole trajectories off, switches of identity included?",
        formula=lambda counts: sum(counts[part] for part in TGOSPA_PARTS) ** (1 / counts["order"]),
        parts=lambda counts: {part: float(counts[part]) for part in TGOSPA_PARTS},
    ),
    Definition(
        name="siap_completeness", group="siap", unit="1", direction="higher", default=False,
        measured=SHARE,
        answers="What share of objects has a track?",
        formula=ratio("tracked", "truths", NO_TRUTH),
    ),
    Definition(
        name="siap_ambiguity", group="siap", unit="1", direction="lower", default=False,
        answers="How many tracks has a tracked object (1 is best)?",
        formula=ratio("associated", "tracked", NO_MATCH),
    ),
    Definition(
        name="siap_spuriousness", group="siap", unit="1", direction="lower", default=False,
        measured=SHARE,
        answers="What share of tracks follows nothing?",
        formula=lambda counts: (
            (counts["tracks"] - counts["associated"]) / counts["tracks"]
            if counts["tracks"]
            else Undefined(NO_TRACKS)
        ),
    ),
    Definition(
        name="siap_position_accuracy", group="siap", unit="m", direction="lower", default=False,
        answers="How far is a track from its object?",
        formula=ratio("position_error", "associated", NO_MATCH),
    ),
    Definition(
        name="siap_velocity_accuracy", group="siap", unit="m/s", direction="lower",
        default=False, answers="How wrong is a track's velocity?",
        formula=ratio("velocity_error", "associated", NO_MATCH),
    ),
    Definition(
        name="siap_track_changes", group="siap", unit="1/s", direction="lower", default=False,
        answers="How often does an object change its track, per time tracked?",
        formula=ratio("track_changes", "time_tracked", NO_MATCH),
    ),
    Definition(
        name="siap_longest_segment", group="siap", unit="1", direction="higher", default=False,
        measured=SHARE,
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


def every() -> Iterable[Definition]:
    """All metrics that `evaluate` knows, in the order of its tables."""
    return _DEFINITIONS


def names() -> Iterable[str]:
    """Every name that `evaluate` knows."""
    return [name + suffix for suffix in ("", OBSERVABLE) for name in _BY_NAME]
