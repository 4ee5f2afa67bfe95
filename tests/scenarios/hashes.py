"""The hashes of the catalogue's recordings, by what the last bits of a result depend on.

python tests/scenarios/hashes.py        writes those of this machine into hashes.json
"""

from __future__ import annotations

import json
from pathlib import Path

from pmbm.sim.scenario.cache import bits_key

FILE = Path(__file__).with_name("hashes.json")
SEED = 0


def digests(name: str) -> dict[str, str]:
    """Of the truth and of the detections of a scenario's plain run."""
    from pmbm.sim import load_scenario

    recording = load_scenario(name).record(SEED)
    return {
        "truth": recording.truth_digest()[:16],
        "detections": recording.detections_digest()[:16],
    }


def stored() -> dict[str, dict[str, str]]:
    """Scenario -> digests, of this machine's key; empty where it has none."""
    if not FILE.exists():
        return {}
    known: dict[str, dict[str, dict[str, str]]] = json.loads(FILE.read_text())
    return known.get(bits_key(), {})


def main() -> None:
    from pmbm.sim import scenario_names

    known = json.loads(FILE.read_text()) if FILE.exists() else {}
    known[bits_key()] = {name: digests(name) for name in scenario_names()}
    FILE.write_text(json.dumps(known, indent=1, sort_keys=True) + "\n")


if __name__ == "__main__":
    main()
