"""Our value for every field of a case, under the field's own name.

One function per family of fields, found by the beginning of the family's key; each gives a nested
dict of the same shape as the case's `expected.<key>.values`.
"""

from __future__ import annotations

import re
from collections.abc import Callable
from dataclasses import asdict
from functools import partial
from typing import Any

import numpy as np
from metric_cases import scene_of_case

from pmbm.metrics.benchmarks.argoverse1 import argoverse1_counts
from pmbm.metrics.benchmarks.kitti import KittiScene, kitti_counts, kitti_scores
from pmbm.metrics.benchmarks.nuscenes import nuscenes_scores
from pmbm.metrics.benchmarks.trackeval import trackeval_counts, trackeval_scores
from pmbm.metrics.benchmarks.waymo import (
    CUTOFFS,
    WaymoCounts,
    WaymoScene,
    waymo_counts,
    waymo_overlap,
    waymo_scores,
)
from pmbm.metrics.core.clear_matching import clear_matches, gated_pairs
from pmbm.metrics.core.scene import pair_overlap
from pmbm.metrics.families.clear import clear_counts
from pmbm.metrics.families.consistency import chi2_bounds, consistency, normalised_squares
from pmbm.metrics.families.gospa import gospa_series
from pmbm.metrics.families.hota import distance_similarity
from pmbm.metrics.families.identity import identity_counts
from pmbm.metrics.families.ospa import ospa_series
from pmbm.metrics.families.ospa2 import ospa2_series
from pmbm.metrics.families.siap import siap_associations, siap_counts
from pmbm.metrics.families.tgospa import tgospa

Case = dict[str, Any]
RANGES = {"[0, 30)": (0.0, 30.0), "[30, 50)": (30.0, 50.0), "[50, +inf)": (50.0, np.inf)}
"""Shards by distance of a box's own centre from the vehicle, m."""
WAYMO_LEAST_OVERLAP = {"VEHICLE": 0.7}


def numbers_in(name: str) -> dict[str, float]:
    """{"c": 5.0, "p": 2.0} of "c5_p2"."""
    return {letter: float(value) for letter, value in re.findall(r"([a-z])(\d+(?:\.\d+)?)", name)}


def ospa(case: Case, key: str, expected: dict[str, Any]) -> dict[str, Any]:
    answers = {}
    for name in expected["values"]:
        n = numbers_in(name)
        result = ospa_series(scene_of_case(case), n["c"], n["p"])
        answers[name] = {
            "total": result.distance,
            "loc": result.localisation,
            "card": result.cardinality,
        }
    return answers


def gospa(case: Case, key: str, expected: dict[str, Any]) -> dict[str, Any]:
    answers = {}
    for name in expected["values"]:
        n = numbers_in(name)
        answers[name] = vars(gospa_series(scene_of_case(case), n["c"], n["p"]))
    return answers


def ospa2(case: Case, key: str, expected: dict[str, Any]) -> dict[str, Any]:
    answers = {}
    for name in expected["values"]:
        window = case["frames"] if name == "wall" else int(name.removeprefix("w"))
        result = ospa2_series(scene_of_case(case), window, cutoff=10.0, order=2.0)
        answers[name] = {
            "total": result.distance,
            "loc": result.localisation,
            "card": result.cardinality,
        }
    return answers


def trajectory(case: Case, key: str, expected: dict[str, Any]) -> dict[str, Any]:
    answers = {}
    for name, values in expected["values"].items():
        n = numbers_in(name)
        result = asdict(tgospa(scene_of_case(case), cutoff=n["c"], order=n["p"], switch=n["g"]))
        parts = [result[part] for part in ("localisation", "missed", "false", "switch")]
        assert sum(parts) == pytest_approx(result["distance"] ** n["p"])
        if values["switch"] > 0:
            # Between equally cheap assignments the parts are not unique, only their sum is.
            result = {"distance": result["distance"], **{p: values[p] for p in PARTS}}
        answers[name] = result
    return answers


PARTS = ("localisation", "missed", "false", "switch")


def pytest_approx(value: float) -> Any:
    import pytest

    return pytest.approx(value, rel=1e-9, abs=1e-9)


def argoverse1(case: Case, key: str, expected: dict[str, Any]) -> dict[str, Any]:
    label = key.removeprefix("argoverse1_")
    counts = argoverse1_counts(scene_of_case(case, label))
    clear, identity = counts.clear, counts.identity
    errors = clear.misses + clear.false_positives + clear.switches
    return {
        "num_frames": counts.frames,
        "mota": _ratio(clear.truths - errors, clear.truths),
        "idf1": _ratio(2 * identity.true_positives, clear.truths + clear.tracks),
        "mostly_tracked": clear.mostly_tracked,
        "mostly_lost": clear.mostly_lost,
        "num_false_positives": clear.false_positives,
        "num_misses": clear.misses,
        "num_switches": clear.switches,
        "num_fragmentations": clear.fragmentations,
        "motp_c": _ratio(clear.distance_sum, clear.matches),
    }


def motp_matched(case: Case, key: str, expected: dict[str, Any]) -> dict[str, Any]:
    counts = argoverse1_counts(scene_of_case(case))
    n = counts.clear.matches
    return {
        "motp_c": _ratio(counts.clear.distance_sum, n),
        "motp_o_deg": _ratio(counts.orientation_sum, n),
        "motp_i": _ratio(counts.size_sum, n),
        "n": n,
    }


def clear_dist2(case: Case, key: str, expected: dict[str, Any]) -> dict[str, Any]:
    scene = scene_of_case(case)
    clear = clear_counts(scene, clear_matches(scene, 2.0))
    identity = identity_counts(scene, gated_pairs(scene, 2.0))
    idtp = identity.true_positives
    errors = clear.misses + clear.false_positives + clear.switches
    return {
        "num_frames": clear.frames,
        "num_objects": clear.truths,
        "num_predictions": clear.tracks,
        "num_matches": clear.matches - clear.switches,
        "num_switches": clear.switches,
        "num_false_positives": clear.false_positives,
        "num_misses": clear.misses,
        "num_fragmentations": clear.fragmentations,
        "num_transfer": clear.transfers,
        "mota": _ratio(clear.truths - errors, clear.truths),
        "motp": _ratio(clear.distance_sum, clear.matches),
        "mostly_tracked": clear.mostly_tracked,
        "partially_tracked": clear.objects - clear.mostly_tracked - clear.mostly_lost,
        "mostly_lost": clear.mostly_lost,
        "idf1": _ratio(2 * idtp, clear.truths + clear.tracks),
        "idp": _ratio(idtp, clear.tracks),
        "idr": _ratio(idtp, clear.truths),
        "idtp": idtp,
        "idfp": identity.false_positives,
        "idfn": identity.misses,
        "precision": _ratio(clear.matches, clear.tracks),
        "recall": _ratio(clear.matches, clear.truths),
    }


def trackeval(case: Case, key: str, expected: dict[str, Any]) -> dict[str, Any]:
    scene = scene_of_case(case)
    kind = key.removeprefix("trackeval_")
    if kind == "dist4":
        similarity = distance_similarity(scene.pairs.distance_xyz, 4.0)
    else:
        similarity = pair_overlap(scene, vertical=kind == "iou3d")
    return trackeval_scores(trackeval_counts(scene, similarity))


def kitti(case: Case, key: str, expected: dict[str, Any]) -> dict[str, Any]:
    kind, digits = key.removeprefix("kitti_").split("_")
    scene = scene_of_case(case)
    least = float(f"0.{digits[1:]}")
    overlap = pair_overlap(scene, vertical=kind == "iou3d")
    counts = kitti_counts(KittiScene.plain(scene, overlap), least)
    return {
        **kitti_scores(counts),
        "tp": counts.matches,
        "fp": counts.false_positives,
        "fn": counts.misses,
        "n_gt": counts.truths,
        "id_switches": counts.switches,
        "fragments": counts.fragmentations,
    }


def nuscenes(case: Case, key: str, expected: dict[str, Any]) -> dict[str, Any]:
    scores = nuscenes_scores([scene_of_case(case)])
    if scores is None:
        nothing = dict.fromkeys(("best_index", "amota", "amotp"))
        return nothing | dict.fromkeys(("confidence", "motar_curve", "motp_curve"), [None] * 40)
    return {
        **scores.at_best,
        "amota": scores.amota,
        "amotp": scores.amotp,
        "best_index": scores.best,
        "best_confidence": scores.confidence[scores.best],
        "confidence": scores.confidence,
        "motar_curve": scores.motar,
        "motp_curve": scores.motp,
    }


def waymo(case: Case, key: str, expected: dict[str, Any]) -> dict[str, Any]:
    answers = {}
    levels: dict[tuple[str, str | None], dict[int, WaymoCounts]] = {}
    for name, values in expected["values"].items():
        match = re.fullmatch(r"(?:RANGE_)?TYPE_([A-Z]+)(?:_(\[.*\)))?_L([12])", name)
        assert match, name
        label, shard, level = match.groups()
        if (label, shard) not in levels:
            sequence = waymo_sequence(case, label)
            if shard:
                sequence = sequence.within(*RANGES[shard])
            least = WAYMO_LEAST_OVERLAP.get(label, 0.5)
            levels[label, shard] = waymo_counts(sequence, least)
        counts = levels[label, shard][int(level)]
        scores = waymo_scores(counts)
        at_cutoffs = {}
        for text in values["at_cutoffs"]:
            at = int(np.argmin(np.abs(CUTOFFS - float(text))))
            at_cutoffs[text] = [
                counts.misses[at],
                counts.false_positives[at],
                counts.mismatches[at],
                counts.cost[at],
                counts.matches[at],
                counts.truths[at],
            ]
        answers[name] = {
            "mota": scores.mota,
            "motp": scores.motp,
            "miss": scores.misses,
            "mismatch": scores.mismatches,
            "fp": scores.false_positives,
            "num_objects_gt": scores.truths,
            "score_cutoff": scores.cutoff or 0.0,
            "has_cutoff": scores.cutoff is not None,
            "at_cutoffs": at_cutoffs,
        }
    return answers


def waymo_sequence(case: Case, label: str) -> WaymoScene:
    """One type of a case, with the difficulty of its truth."""
    scene = scene_of_case(case, label)
    column = case["gt_columns"].index("level")
    rows = sorted(
        (k, row[0], row[column])
        for k, frame in enumerate(case["gt"])
        for row in frame
        if row[1] == label
    )
    return WaymoScene(
        scene=scene,
        overlap=waymo_overlap(scene),
        level=np.array([row[-1] for row in rows], np.int64),
        in_no_label_zone=np.zeros(len(scene.tracks), np.bool_),
    )


def siap(
    case: Case, key: str, expected: dict[str, Any], confirm: int = 1, end: int = 1
) -> dict[str, Any]:
    scene = scene_of_case(case, dt=expected.get("seconds_per_frame", 1.0))
    counts = siap_counts(scene, siap_associations(scene, confirm=confirm, end=end))
    return {
        "SIAP Completeness": counts.tracked / max(counts.truths, 1),
        "SIAP Ambiguity": counts.associated / counts.tracked if counts.tracked else 1.0,
        "SIAP Spuriousness": (counts.tracks - counts.associated) / max(counts.tracks, 1),
        # The program gives 0 for what nothing defines.
        "SIAP Position Accuracy": counts.position_error / max(counts.associated, 1),
        "SIAP Velocity Accuracy": counts.velocity_error / max(counts.associated, 1),
        "SIAP Rate of Track Number Change": counts.track_changes / (counts.time_tracked or 1.0),
        "SIAP Longest Track Segment": counts.longest_segment / (counts.lifetime or 1.0),
    }


def iou_frame0(case: Case, key: str, expected: dict[str, Any]) -> dict[str, Any]:
    scene = scene_of_case(case)
    first = scene.with_rows(scene.truth.frame == 0, scene.tracks.frame == 0)
    # The case lists boxes in the file's order, the scene in that of the ids.
    shape = (len(first.truth), len(first.tracks))
    rows = _rank([row[0] for row in case["gt"][0] if row[1] == "VEHICLE"])
    columns = _rank([row[0] for row in case["trk"][0] if row[1] == "VEHICLE"])
    answers = {}
    for name, vertical in (("iou3d", True), ("ioubev", False)):
        table = pair_overlap(first, vertical=vertical).reshape(shape)
        empty = expected[name] if table.size == 0 and not np.size(expected[name]) else None
        answers[name] = table[np.ix_(rows, columns)] if empty is None else empty
    return answers


def nees(case: Case) -> dict[str, Any]:
    squares = normalised_squares(case["errors"], case["covs"])
    result = consistency(squares, case["dim"])
    return {
        "nees": squares,
        "nees_run_mean": result.run_mean,
        "bounds95_per_step": result.step_bounds,
        "fraction_inside": result.fraction_inside,
        "time_mean": result.mean,
        # The reference takes all steps for independent, as these cases draw them.
        "bounds95_overall": chi2_bounds(case["dim"], squares.size),
    }


def associations(case: Case, confirm: int = 2, end: int = 2) -> list[tuple[str, str, int, int]]:
    """(truth, track, first frame, last frame) by the case's own ids, in order."""
    truths = sorted({row[0] for frame in case["gt"] for row in frame})
    tracks = sorted({row[0] for frame in case["trk"] for row in frame})
    found = siap_associations(scene_of_case(case, dt=1.0), confirm=confirm, end=end)
    return sorted((truths[a.truth], tracks[a.track], a.first, a.last) for a in found)


def given_associations(case: Case) -> list[tuple[str, str, int, int]]:
    """The case's associations, in order; one with several spells is written as times, 1 s from
    frame to frame, the first frame at midnight."""
    rows = []
    for row in case["associations"]:
        if isinstance(row[0], str):
            rows.append(tuple(row))
            continue
        (truth, track), spells = row
        stamps = re.findall(r"datetime\(\d+, \d+, \d+, (\d+), (\d+)(?:, (\d+))?\)", spells)
        frames = [3600 * int(h) + 60 * int(m) + int(s or 0) for h, m, s in stamps]
        rows += [(truth, track, *spell) for spell in zip(frames[::2], frames[1::2], strict=True)]
    return sorted(rows)


ANSWERS: dict[str, Callable[..., dict[str, Any]]] = {
    "ospa2": ospa2,
    "ospa": ospa,
    "gospa": gospa,
    "tgospa": trajectory,
    "argoverse1_": argoverse1,
    "motp_matched": motp_matched,
    "clear_dist2": clear_dist2,
    "trackeval_": trackeval,
    "kitti_": kitti,
    "nuscenes": nuscenes,
    "waymo": waymo,
    "siap": siap,
    "iou_frame0": iou_frame0,
}

siap_of_two = partial(siap, confirm=2, end=2)


def answer_for(key: str) -> Callable[..., dict[str, Any]] | None:
    """The function that answers `expected.<key>`, or None where none does."""
    return next((ANSWERS[start] for start in ANSWERS if key.startswith(start)), None)


def _ratio(top: float, bottom: float) -> float | None:
    return top / bottom if bottom else None


def _rank(names: list[str]) -> list[int]:
    order = sorted(names)
    return [order.index(name) for name in names]
