"""Simulated studies for the gate: paired values of a metric in [0, 1], and their verdicts."""

from dataclasses import dataclass

import numpy as np

from pmbm.regression.verdicts import Pairs, Rules, Verdict, judge

TRIALS = 1500


@dataclass(frozen=True)
class World:
    """How a metric varies: by the scene that both trackers share, and by each pair's own luck."""

    margin: float
    scene_sd: float = 0.1
    pair_sd: float = 0.03

    @property
    def rules(self):
        return Rules(margin=self.margin, max_trials=TRIALS)

    def study(self, rng, smooth=0.0, disaster_rate=0.0, disaster_loss=0.0, paired=True):
        """One study's values; `smooth` and `disaster_loss` in units of the metric."""
        scene = rng.normal(0.3, self.scene_sd, (2, TRIALS))
        loss = smooth + disaster_loss * (rng.random(TRIALS) < disaster_rate)
        candidate = scene[0 if paired else 1] + loss + rng.normal(0.0, self.pair_sd, TRIALS)
        return Pairs(baseline=scene[0], candidate=candidate, value_range=1.0)


def verdicts(world, studies, seed, **change):
    """Verdicts (list) and trials used (array) of many studies, each on a stream of its own."""
    found = [
        judge({"scene": world.study(np.random.default_rng([seed, k]), **change)}, world.rules)
        for k in range(studies)
    ]
    decisions = [one["scene"] for one in found]
    return [d.verdict for d in decisions], np.array([d.trials for d in decisions])


def share(found, kind):
    return sum(verdict is kind for verdict in found), len(found)


def power_against_unpaired(world, studies, seed):
    """How many studies of a loss of two margins fail within a quarter of the trials at which the
    unpaired design has failed nine in ten; and that number."""
    found, trials = verdicts(world, studies, seed, smooth=2 * world.margin, paired=False)
    failed = np.array([verdict is Verdict.FAIL for verdict in found])
    needed = np.quantile(np.where(failed, trials, np.inf), 0.9, method="higher")
    found, trials = verdicts(world, studies, seed + 1, smooth=2 * world.margin)
    failed = np.array([verdict is Verdict.FAIL for verdict in found])
    return int((failed & (trials <= needed / 4)).sum()), studies, needed
