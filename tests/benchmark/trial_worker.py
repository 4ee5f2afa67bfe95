"""Trials of one build of the project, timed in a process of its own.

Started by trial.py as `python trial_worker.py`, with the build first on PYTHONPATH; runs any commit
since the first that was measured.  Each line in names a scenario, a seed and the tracker, "default"
or "map"; each line out the CPU seconds of recording, following and evaluating.
"""

import itertools
import json
import sys
import time
from importlib import import_module

# An editable install of another commit would be found before PYTHONPATH.
sys.meta_path[:] = [f for f in sys.meta_path if not type(f).__module__.startswith("_editable")]


def main():
    from pmbm import PMBMTracker, evaluate, run

    try:
        scenarios = import_module("pmbm.sim.scenario.scenario")
    except ModuleNotFoundError:
        scenarios = import_module("sim.scenario")
    # Every scene is simulated.
    scenarios.cached = lambda name, key, seed, trial, make: make()
    for line in sys.stdin:
        name, seed, kind = json.loads(line)
        source = scenarios.load_scenario(name)
        clock = [time.process_time()]
        recording = source.record(seed)
        clock.append(time.process_time())
        made = PMBMTracker.with_map if kind == "map" else PMBMTracker
        tracks = run(made(site=recording.site), recording)
        clock.append(time.process_time())
        evaluate(recording, tracks)
        clock.append(time.process_time())
        seconds = [after - before for before, after in itertools.pairwise(clock)]
        sys.stdout.write(json.dumps(seconds) + "\n")
        sys.stdout.flush()


if __name__ == "__main__":
    main()
