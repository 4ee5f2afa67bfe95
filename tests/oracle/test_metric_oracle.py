"""Every metric against the values that the metrics' own reference programs give.

The cases come from `PMBM_METRIC_CASES`, or from the copy beside this file; every case file found
there is run, and every field of it is asserted at the case's own tolerance, but for the fields
that depend on the order of objects in the reference program and those listed below.
"""

from __future__ import annotations

import json
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from metric_answers import answer_for, associations, given_associations, nees, siap_of_two
from metric_cases import case_files, case_folder, load

NOT_ASSERTED = {
    "motp_i_peer": "mixes distances of three matchings; the definition is motp_matched.motp_i",
    "motp_o_peer_deg": "mixes distances of three matchings; see motp_matched.motp_o_deg",
}
"""Fields that the reference program computes otherwise than its benchmark defines, by name."""
PEER_QUIRK = (
    "the program adds a dummy frame where no pair exists in the whole run; such a case follows "
    "clear_dist2 in every field that it has"
)
MATCHES_ABOUT_THE_CASE = {"tol", "order_sensitive", "note", "peer_error", "peer_quirk"}
SETTINGS = {"seconds_per_frame"}

asserted: dict[str, int] = {}
left_out: dict[str, int] = {}


def test_the_metric_folder_holds_cases():
    assert case_files(), f"no metric cases in {case_folder()}"


@pytest.mark.parametrize("path", case_files(), ids=lambda path: path.stem)
def test_metric_case(path: Path, capsys: pytest.CaptureFixture[str]):
    content = load(path)
    kind = content.get("kind", "tracking")
    before = sum(asserted.values())
    if kind == "nees":
        for case in content["cases"]:
            given = {
                name: case[name]
                for name in case.keys() - {"dim", "steps", "runs", "errors", "covs"}
            }
            compare(given, nees(case), tolerance=content["tol"], where=f"{path.stem}")
    elif kind == "siap":
        for case in content["cases"]:
            run_case(case, {"siap": siap_of_two})
            assert associations(case) == given_associations(case), case["name"]
            asserted["associations"] = asserted.get("associations", 0) + len(case["associations"])
    else:
        run_case(content, {})
    with capsys.disabled():
        print(f" {path.stem}: {sum(asserted.values()) - before} values", end="")


def test_metric_values_asserted(capsys: pytest.CaptureFixture[str]):
    """Says how much the cases have checked; it runs after them."""
    if not asserted:
        pytest.skip("the cases themselves were not selected")
    with capsys.disabled():
        print(f"\n{sum(asserted.values())} metric values asserted in {len(case_files())} files")
        for name, count in sorted(left_out.items()):
            print(f"  not asserted: {name} ({count} times): {reason(name)}")


def run_case(case: dict[str, Any], special: dict[str, Any]) -> None:
    for key, expected in case["expected"].items():
        if expected.get("peer_error"):
            count(left_out, f"{key}: the reference program failed", 1)
            continue
        answer = special.get(key) or answer_for(key)
        assert answer, f"{case['name']}: unknown metric {key}; give an answer or a reason"
        sensitive = set(expected.get("order_sensitive") or ())
        ours = answer(case, key, expected)
        given = expected.get("values")
        if given is None:
            given = {
                name: expected[name] for name in expected.keys() - MATCHES_ABOUT_THE_CASE - SETTINGS
            }
        if expected.get("peer_quirk"):
            right = case["expected"]["clear_dist2"]["values"]
            count(left_out, f"{key} of cases with a peer_quirk", len(given.keys() - right.keys()))
            given = {name: right[name] for name in given.keys() & right.keys() - {"num_frames"}}
        kept = {}
        for name, value in given.items():
            if name in sensitive:
                count(left_out, "order-sensitive fields", 1)
            elif name in NOT_ASSERTED:
                count(left_out, name, 1)
            else:
                kept[name] = value
        compare(kept, ours, tolerance=expected["tol"], where=f"{case['name']}.{key}")


def compare(given: Any, ours: Any, *, tolerance: float, where: str) -> None:
    wrong = []
    total = 0
    for place, expected, got in leaves(given, ours, where):
        total += 1
        if expected is None:
            agrees = got is None or (isinstance(got, float) and np.isnan(got))
        else:
            agrees = got is not None and abs(float(got) - float(expected)) <= tolerance
        if not agrees:
            wrong.append(f"{place}: expected {expected}, got {got}")
    assert not wrong, f"{len(wrong)} of {total} values differ:\n" + "\n".join(wrong[:20])
    count(asserted, where.split(".")[-1], total)


def leaves(given: Any, ours: Any, where: str) -> Iterator[tuple[str, Any, Any]]:
    """Each expected number with ours; a missing name or another length is an error."""
    if isinstance(given, dict):
        for name, value in given.items():
            assert name in ours, (
                f"{where}: unknown field {name}; answer it or list it with a reason"
            )
            yield from leaves(value, ours[name], f"{where}.{name}")
    elif isinstance(given, list):
        assert len(given) == len(ours), f"{where}: expected {len(given)} values, got {len(ours)}"
        for place, (expected, got) in enumerate(zip(given, ours, strict=True)):
            yield from leaves(expected, got, f"{where}[{place}]")
    else:
        yield where, given, ours


def reason(name: str) -> str:
    if name in NOT_ASSERTED:
        return NOT_ASSERTED[name]
    if "peer_quirk" in name:
        return PEER_QUIRK
    return "a tie, or the order of objects in the reference program" if "order" in name else ""


def count(table: dict[str, int], name: str, more: int) -> None:
    table[name] = table.get(name, 0) + more


def test_manifest_of_the_metric_cases_is_readable():
    manifest = case_folder() / "MANIFEST.json"
    if not manifest.exists():
        pytest.skip("this folder has no manifest")
    assert json.loads(manifest.read_text(encoding="utf-8"))["peers"]
