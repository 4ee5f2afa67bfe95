"""`pmbm tune`: a tracker's parameters by Optuna, on scenarios or on a dataset's sequences."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager
from pathlib import Path
from typing import TYPE_CHECKING, Any

import click

from pmbm.cli import INTERRUPTED, dataset_options, options
from pmbm.cli.many import ManyValues
from pmbm.cli.options import FILE

if TYPE_CHECKING:
    from pmbm.cli.tuning import Gains, Logged, Simulated, Spread
    from pmbm.study import ConfiguredTracker
    from pmbm.tune import Progress, Space, Tuned

_OF_SCENARIOS = ("recordings", "held_back")
_OF_DATASETS = ("root", "detections", "poses", "kind", "sequences", "rule", "mode")


@click.command(cls=ManyValues)
@click.argument("scenarios", nargs=-1, metavar="[SCENARIO|FILE.toml]...")
@click.option("--dataset", "dataset_name", metavar="NAME", help="Instead of scenarios.")
@dataset_options.root("The dataset's folder, with its truth.", required=False)
@dataset_options.detections("As for pmbm track.", required=False)
@dataset_options.poses
@click.option("--class", "kind", metavar="CLASS", help="The dataset's class to tune for.")
@dataset_options.sequences
@dataset_options.rule
@options.mode
@options.tracker
@click.option(
    "--config",
    type=FILE,
    metavar="FILE.toml",
    help="The parameters to begin with and to beat.  [default: those that pmbm track would take]",
)
@click.option("--metric", help="What to make better.  [default: gospa; of a rule, its first]")
@click.option(
    "--space",
    "space_file",
    type=FILE,
    metavar="FILE.toml",
    help="Where to look: gate = { low = 6.0, high = 60.0, log = true } or [10.0, 20.0], a line a "
    "parameter.  [default: the shipped trackers have one each]",
)
@click.option(
    "--fit",
    "fitted",
    is_flag=True,
    help="First fit what is no search: of pmbm what scores say, of probabilistic_kf its noise.",
)
@click.option(
    "--recordings",
    type=click.IntRange(min=1),
    default=5,
    show_default=True,
    help="Of each scenario, to tune on.",
)
@click.option(
    "--held-back",
    type=click.IntRange(min=2),
    default=20,
    show_default=True,
    help="Recordings of each scenario, of another seed, to compare with the defaults on.",
)
@click.option(
    "--trials",
    type=click.IntRange(min=2),
    default=50,
    show_default=True,
    help="Sets of parameters to try, the defaults first.",
)
@click.option("--seed", type=click.IntRange(min=0), default=1, show_default=True)
@dataset_options.jobs
@click.option("--out", type=FILE, metavar="FILE.toml", help="[default: standard output]")
@click.pass_context
def command(
    context: click.Context,
    scenarios: tuple[str, ...],
    dataset_name: str | None,
    root: Path | None,
    detections: str | None,
    poses: Path | None,
    kind: str | None,
    sequences: tuple[str, ...],
    rule: str | None,
    mode: str,
    tracker_name: str,
    config: Path | None,
    metric: str | None,
    space_file: Path | None,
    fitted: bool,
    recordings: int,
    held_back: int,
    trials: int,
    seed: int,
    jobs: int,
    out: Path | None,
) -> int:
    """Search a tracker's parameters on simulated recordings of SCENARIOs, then compare them with
    the defaults on recordings of another seed; or search on a dataset's sequences by its own rule.
    Seeds that are kept for reporting are refused.

    The file that it writes is for `pmbm track --config`; a study file names it as
    `config` under [tracker.NAME].

    \b
    Examples:
      pmbm tune crossing truck_occlusion --trials 100 --out tuned.toml
      pmbm tune empty_clutter --tracker argoverse --metric ospa --space space.toml
      pmbm tune --dataset kitti --root kitti --detections 'kitti/detections/pointrcnn_{class}' \\
        --poses kitti/pose --class Car --metric HOTA --sequences 0000 0003 --out car.toml
    """
    from threadpoolctl import threadpool_limits

    from pmbm.cli.sources import resolve
    from pmbm.cli.track import read_toml
    from pmbm.cli.tuning import Logged, Simulated
    from pmbm.durable import check_writable, replace_text
    from pmbm.errors import InputError
    from pmbm.provenance import made_with
    from pmbm.sim.toml_tables import toml_text
    from pmbm.study import ConfiguredTracker
    from pmbm.tune import refuse_reserved_seed, tune

    if (dataset_name is None) == (not scenarios):
        raise InputError("tune on scenarios or on a dataset", expected="names, or --dataset NAME")
    _refuse_given(context, _OF_DATASETS if dataset_name is None else _OF_SCENARIOS)
    refuse_reserved_seed(seed)
    # Found out before the search, not after it.
    if out is not None:
        check_writable(out)
    with _pool(jobs) as spread, threadpool_limits(limits=1):
        problem: Simulated | Logged
        if dataset_name is None:
            values = {} if config is None else read_toml(config)
            tracker = ConfiguredTracker(tracker_name, tuple(values.items()))
            space = _space(tracker, space_file, config)
            sources = [resolve(name, {}) for name in scenarios]
            problem = Simulated.of(
                sources,
                tracker,
                metric or "gospa",
                seed,
                recordings,
                spread,
                fitted=fitted,
            )
        else:
            problem = Logged.of(
                dataset_name,
                {"root": root, "detections": detections, "poses": poses},
                kind,
                sequences,
                tracker_name,
                config=config,
                metric=metric,
                rule=rule,
                mode=mode,
                spread=spread,
                fitted=fitted,
            )
            space = _space(problem.tracker, space_file, config)
        present = present_values(problem.tracker, space)
        with _bar(problem.metric) as progress:
            tuned = tune(
                lambda parameters: _value(problem, parameters),
                space,
                trials=trials,
                seed=seed,
                maximise=problem.maximise,
                defaults=present,
                progress=progress,
            )
        gains: Gains = []
        verdict = "Nothing beat the defaults."
        if tuned.interrupted:
            verdict = "Stopped: nothing was compared on held-back recordings."
        elif tuned.parameters and isinstance(problem, Logged):
            verdict = problem.advice
        elif tuned.parameters and isinstance(problem, Simulated):
            gains, verdict = _held_back(problem, tuned, seed, held_back)
    found = (
        f"{problem.metric} on {problem.where}: {tuned.value:z.5g}, "
        f"with the defaults {tuned.default_value:z.5g}."
    )
    _show(problem.metric, present, tuned, gains, to_stderr=out is None)
    for line in (found, verdict):
        click.echo(line, err=out is None)
    tried = len(tuned.attempts)
    of = f" (of {trials}: stopped)" if tuned.interrupted else ""
    what = f"The {tracker_name} tracker's best of {tried} sets of parameters{of}, seed {seed}."
    document = problem.document(tuned.parameters or present)
    text = _comment(what, found, verdict, made_with("optuna"), "Made by:") + toml_text(document)
    if out is None:
        click.echo(text, nl=False)
    else:
        replace_text(out, text)
        click.echo(out)
    return INTERRUPTED if tuned.interrupted else 0


def _value(problem: Simulated | Logged, parameters: Mapping[str, Any]) -> float | None:
    """The objective, or None for parameters that each may have but that do not fit together."""
    from pmbm.errors import InputError
    from pmbm.types import Site

    tracker = _with(problem.tracker, parameters)
    try:
        tracker(Site())
    except InputError:
        return None
    return problem.value(tracker)


def _with(tracker: ConfiguredTracker, parameters: Mapping[str, Any]) -> ConfiguredTracker:
    """The tracker with these parameters over its own."""
    from pmbm.study import ConfiguredTracker
    from pmbm.study.configured import nested

    own = nested({**dict(tracker.parameters), **parameters})
    return ConfiguredTracker(tracker.factory, tuple(own.items()))


def _space(tracker: ConfiguredTracker, file: Path | None, config: Path | None) -> Space:
    """Where to look, of a file or as shipped; its ends and choices are values that the tracker
    takes."""
    from pmbm.cli.track import read_toml
    from pmbm.errors import InputError
    from pmbm.tune import SPACES, Choice, Range, parse_space
    from pmbm.types import Site

    try:
        tracker(Site())
    except InputError as error:
        raise error.located(file=error.file or config) from None
    if file is None and tracker.factory not in SPACES:
        raise InputError(
            f"where to look for the parameters of '{tracker.factory}'?",
            field="--space",
            expected="a file",
            hint="a line a parameter: gate = { low = 6.0, high = 60.0, log = true }",
        )
    try:
        space = SPACES[tracker.factory] if file is None else parse_space(read_toml(file))
        ranges = {name: place for name, place in space.items() if isinstance(place, Range)}
        # Together, for bounds that keep apart parameters which have an order.
        _with(tracker, {name: place.low for name, place in ranges.items()})(Site())
        _with(tracker, {name: place.high for name, place in ranges.items()})(Site())
        for name, place in space.items():
            for value in place.values if isinstance(place, Choice) else ():
                _with(tracker, {name: value})(Site())
    except InputError as error:
        raise error.located(file=error.file or file) from None
    return space


def present_values(tracker: ConfiguredTracker, space: Space) -> dict[str, Any]:
    """The values that a tracker's parameters have as it is, as far as it shows them."""
    import inspect
    from operator import attrgetter

    from pmbm.tracking import tracker_factory
    from pmbm.types import Site

    signature = inspect.signature(tracker_factory(tracker.factory))
    values = {
        name: parameter.default
        for name, parameter in signature.parameters.items()
        if parameter.default is not parameter.empty
    }
    values |= dict(tracker.parameters)
    config = getattr(tracker(Site()), "config", None)
    for name in space:
        try:
            values[name] = attrgetter(name)(config)
        except AttributeError:
            continue
    return {name: values[name] for name in space if name in values}


def _held_back(problem: Simulated, tuned: Tuned, seed: int, count: int) -> tuple[Gains, str]:
    """The gain on recordings of another seed, and what it says."""
    from pmbm.cli.tuning import Simulated
    from pmbm.tune import FIRST_HELD_BACK_SEED

    held = Simulated.of(
        problem.sources,
        problem.tracker,
        problem.metric,
        seed + FIRST_HELD_BACK_SEED,
        count,
        problem.spread,
    )
    rows = held.gains(_with(problem.tracker, tuned.parameters))
    gain = rows[-1][3]
    if gain.mean is None:
        return rows, f"On held-back {held.where} the gain is undefined."
    if gain.low is None or gain.high is None:
        return rows, f"On held-back {held.where} the gain is {gain.mean:.4g} in all trials."
    gained = gain.low > 0 if problem.maximise else gain.high < 0
    return rows, (
        f"On held-back {held.where}, tuned - defaults: {gain.mean:z.4g}, 95 % interval "
        f"{gain.low:z.4g} to {gain.high:z.4g}: {'better' if gained else 'not shown to be better'}."
    )


def _refuse_given(context: click.Context, names: Sequence[str]) -> None:
    """Options that say nothing here are not passed over in silence."""
    from click.core import ParameterSource

    from pmbm.errors import InputError

    for parameter in context.command.params:
        given = context.get_parameter_source(parameter.name or "") is ParameterSource.COMMANDLINE
        if parameter.name in names and given:
            where = "a dataset" if names is _OF_DATASETS else "scenarios"
            raise InputError(f"for {where} only", field=parameter.opts[0])


@contextmanager
def _pool(jobs: int) -> Iterator[Spread]:
    """`map`; with several jobs, that of a pool that lasts as long as the search."""
    if jobs == 1:
        yield map
        return
    from pmbm.study.parallel import workers

    with workers(jobs) as pool:
        yield pool.map


@contextmanager
def _bar(metric: str) -> Iterator[Progress]:
    """A bar on stderr, with the best value so far."""
    from rich.progress import BarColumn, MofNCompleteColumn, TextColumn, TimeRemainingColumn

    from pmbm.cli.progress import bar

    columns = (BarColumn(), MofNCompleteColumn(), TextColumn("{task.description}"))
    with bar(*columns, TimeRemainingColumn()) as shown:
        task = shown.add_task("with the defaults", total=None)
        yield lambda done, total, best: shown.update(
            task, completed=done, total=total, description=f"best {metric} {best:.5g}"
        )


def _show(
    metric: str,
    present: Mapping[str, Any],
    tuned: Tuned,
    gains: Gains,
    *,
    to_stderr: bool,
) -> None:
    from rich.console import Console
    from rich.table import Table
    from rich.text import Text

    console = Console(stderr=to_stderr)
    table = Table("parameter")
    for column in ("default", "tuned"):
        table.add_column(column, justify="right")
    for name in tuned.parameters or present:
        table.add_row(name, _text(present.get(name)), _text(tuned.parameters.get(name)))
    console.print(table)
    if not gains:
        return
    title = f"mean {metric} on held-back recordings [95 % interval]"
    table = Table("scenario", title=title, title_justify="left")
    for column in ("default", "tuned", "tuned - default"):
        table.add_column(column, justify="right")
    for name, before, after, gain in gains:
        reach = "" if gain.low is None else f" [{_text(gain.low)}, {_text(gain.high)}]"
        table.add_row(
            name, _text(before.mean), _text(after.mean), Text(f"{_text(gain.mean)}{reach}")
        )
    console.print(table)


def _text(value: Any) -> str:
    if value is None:
        return "-"
    return f"{value:.4g}" if isinstance(value, float) else str(value)


def _comment(*lines: str) -> str:
    """Lines at the head of a file, folded to be read there."""
    import textwrap

    folded = (
        textwrap.fill(
            line, 98, initial_indent="# ", subsequent_indent="#   ",
            break_long_words=False, break_on_hyphens=False,
        )
        for line in lines
    )  # fmt: skip
    return "\n".join((*folded, f"#   {_command_line()}")) + "\n\n"


def _command_line() -> str:
    import shlex
    import sys

    return " ".join(shlex.join(["pmbm", *sys.argv[1:]]).split())
