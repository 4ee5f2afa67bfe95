"""`pmbm falsify`: search a scenario for what breaks a tracker, and keep the smallest that does."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import TYPE_CHECKING, Any

import click

from pmbm.cli import options, settings
from pmbm.cli.options import FILE

if TYPE_CHECKING:
    from pmbm.sim.search.falsify import Badness, Finding, Knob
    from pmbm.study import ConfiguredTracker


@click.command()
@click.argument("scenario_name", metavar="SCENARIO|FILE.toml")
@options.tracker
@settings.option
@click.option("--metric", default="gospa", show_default=True, help="What to make worse.")
@click.option(
    "--limit",
    type=float,
    help="Beyond this the scenario fails.  [default: half-way to the worst found]",
)
@click.option(
    "--vary",
    "varied",
    type=(str, float, float),
    multiple=True,
    metavar="KEY LEAST MOST",
    help="A dotted key to vary.  [default: the swept ones and the detector's faults]",
)
@click.option(
    "--budget",
    type=click.IntRange(min=2),
    default=60,
    show_default=True,
    help="Scenarios to try in the search; making the worst smaller tries about as many again.",
)
@click.option(
    "--trials", type=click.IntRange(min=1), default=1, show_default=True, help="Of each scenario."
)
@options.seed
@click.option(
    "--out",
    type=FILE,
    help="The file to write.  [default: NAME_falsified.toml]",
)
def command(
    scenario_name: str,
    tracker_name: str,
    settings: tuple[str, ...],
    metric: str,
    limit: float | None,
    varied: tuple[tuple[str, float, float], ...],
    budget: int,
    trials: int,
    seed: int,
    out: Path | None,
) -> None:
    """Search the parameters of SCENARIO for the tracker's worst case; write the smallest failing
    scenario as a file that can be kept as a regression test.

    Exit code 1 where a failing scenario was found, 0 where none was.

    \b
    Examples:
      pmbm falsify crossing --metric id_switches --limit 2
      pmbm falsify single_straight --vary detector.clutter.rate 0 30 --out worst.toml
    """
    import shlex
    import sys

    from pmbm.cli.settings import configured, shown_name
    from pmbm.durable import check_writable, replace_text
    from pmbm.errors import InputError, Verbatim
    from pmbm.metrics.catalogue import definition
    from pmbm.sim import load_scenario
    from pmbm.sim.search.falsify import FAULTS, Knob, search, swept_knobs
    from pmbm.sim.toml_tables import toml_text

    scenario = load_scenario(scenario_name)
    name = f"{scenario.name}_falsified"
    path = out or Path(f"{name}.toml")
    check_writable(path)
    for key, least, most in varied:
        if not least < most:
            raise InputError(
                "nothing to vary",
                field=f"--vary {key}",
                expected="LEAST below MOST",
                got=Verbatim(f"{least:g} {most:g}"),
            )
    shown = shown_name(tracker_name, settings)
    sign = -1.0 if definition(metric).direction == "higher" else 1.0
    base = scenario.base()
    swept = swept_knobs(scenario)
    known = {knob.key for knob in swept}
    knobs: list[Knob] = [
        Knob(key, least, most, _at_rest(base.document, key, least)) for key, least, most in varied
    ] or [*swept, *(fault for fault in FAULTS if fault.key not in known)]
    _check(base.document, knobs)
    finding = search(
        base.document,
        badness_of(configured(tracker_name, settings), metric, sign, trials, seed),
        knobs,
        budget=budget,
        limit=None if limit is None else sign * limit,
        seed=seed,
    )
    if finding is None:
        click.echo(f"nothing found: {metric} of {shown} stayed within the limit")
        return
    document = {**finding.document, "name": name}
    again = ["pmbm", "run", str(path), "--tracker", tracker_name]
    again += [word for one in settings for word in ("--set", one)]
    again += ["--seed", str(seed), "--trials", str(trials)]
    replace_text(
        path,
        _header(scenario_name, shown, metric, sign, finding, shlex.join(again))
        + toml_text(document),
    )
    changed = ", ".join(f"{key} = {value:g}" for key, value in finding.changed.items()) or "nothing"
    click.echo(
        f"{metric} {sign * finding.rest:z.4g} -> {sign * finding.value:z.4g} "
        f"after {finding.evaluations} scenarios; changed: {changed}\n{path}"
    )
    sys.exit(1)


def badness_of(
    tracker: ConfiguredTracker | str, metric: str, sign: float, trials: int, seed: int
) -> Badness:
    """The metric, larger is worse, of a scenario's document."""
    import numpy as np

    from pmbm.errors import InputError, notes_of
    from pmbm.metrics import evaluate
    from pmbm.seeding import tracker_seed
    from pmbm.sim.scenario.scenario import Scenario
    from pmbm.study.configured import follow

    def badness(document: Mapping[str, Any]) -> float:
        scenario = Scenario(document)
        values = []
        for trial in range(trials):
            recording = scenario.record(seed, trial)
            try:
                tracks = follow(tracker, recording, tracker_seed(seed, trial))
            except InputError as error:
                # The search takes an InputError for a world that there cannot be.
                said = [str(error.located(run=f"trial {trial}")), *notes_of(error)]
                raise click.ClickException("; ".join(said)) from error
            value = evaluate(recording, tracks, [metric]).scalars()[metric]
            if value is not None:
                values.append(sign * value)
        return float(np.mean(values)) if values else -np.inf

    return badness


def _at_rest(document: Mapping[str, Any], key: str, least: float) -> float:
    """The document's value at a dotted key; the least value where there is none."""
    table: Any = document
    for part in key.split("."):
        if not isinstance(table, Mapping) or part not in table:
            return least
        table = table[part]
    return float(table) if isinstance(table, int | float) else least


def _check(document: Mapping[str, Any], knobs: list[Knob]) -> None:
    """Refuse keys that the scenario does not take, before anything is searched."""
    from pmbm.sim.scenario.scenario import Scenario
    from pmbm.sim.search.falsify import with_values

    for knob in knobs:
        Scenario(with_values(document, {knob.key: knob.at(0.5)}))


def _header(
    scenario: str,
    tracker: str,
    metric: str,
    sign: float,
    finding: Finding,
    again: str,
) -> str:
    from pmbm.provenance import made_with

    return (
        f"# Stresses what {tracker} does worst in {scenario}: {metric} "
        f"{sign * finding.value:z.4g}, where {scenario} as it is has {sign * finding.rest:z.4g}.\n"
        f"# Found by a search, made smaller while it failed.  {made_with()}\n"
        f"# See it again with\n"
        f"#   {again}\n\n"
    )
