"""The command line: one module a command, loaded when it is called.

Exit codes: 0 done, 1 a gate failed or trials failed, 2 bad input, 3 undecided, 130 stopped.
"""

from __future__ import annotations

import importlib
import sys
from collections.abc import Iterator
from contextlib import contextmanager
from typing import Any

import click

COMMANDS = {
    "init": "A tracker's repository to begin with: tracker, tests, study, gate, CI file.",
    "scenarios": "What ships, one line each; or one scenario in full.",
    "run": "One or a few trials of a scenario: a table and an HTML replay.",
    "picture": "One frame of a trial, or its error over time, as SVG or PNG.",
    "study": "A Monte Carlo study that can be resumed; trials over processes or a cluster.",
    "digest": "One line that is equal where the results of two studies are equal.",
    "report": "A study as one HTML file: verdicts, curves, worst trials to replay.",
    "versus": "One tracker of a study against each of the others: better or worse, and where.",
    "gate": "Did the tracker get worse? Exit code 0: no, 1: yes, 3: undecided.",
    "export": "Recordings of a scenario or dataset as tables that other programs read.",
    "track": "A tracker over a real dataset, output in that dataset's format.",
    "metrics": "Which metric answers which question.",
    "evaluate": "Any tracker's output, by the rules of the dataset it was made on.",
    "submit": "Results of many sequences as the one file that a benchmark takes.",
    "compare": "Several trackers over a dataset: who is better, by how much, and how surely.",
    "fit-detector": "A detector profile from labels and detections, and how well it fits.",
    "fit-tracker": "A preset for a detector of one's own, and what it is worth elsewhere.",
    "falsify": "Search a scenario for what breaks a tracker; keep the smallest that does.",
    "tune": "A tracker's parameters by Optuna, on scenarios or on a dataset's sequences.",
    "cache": "The simulated scenes kept on disk: show, list, clear.",
}
"""Name -> one-line help; `pmbm/cli/NAME.py` (dashes as underscores) holds `command`."""


INTERRUPTED = 130
"""Exit code of what was stopped by Ctrl-C; what it had is kept."""


class _LazyGroup(click.Group):
    """A group that knows its commands' names and help without importing them."""

    def list_commands(self, ctx: click.Context) -> list[str]:
        return list(COMMANDS)

    def get_command(self, ctx: click.Context, cmd_name: str) -> click.Command | None:
        if cmd_name not in COMMANDS:
            return None
        module = importlib.import_module(f"pmbm.cli.{cmd_name.replace('-', '_')}")
        command: click.Command = module.command
        return command

    def resolve_command(
        self, ctx: click.Context, args: list[str]
    ) -> tuple[str | None, click.Command | None, list[str]]:
        from pmbm.errors import InputError, nearest_hint

        if args and not args[0].startswith("-") and args[0] not in COMMANDS:
            raise InputError(
                f"no command '{args[0]}'", hint=nearest_hint(args[0], COMMANDS, "command")
            )
        return super().resolve_command(ctx, args)

    def format_commands(self, ctx: click.Context, formatter: click.HelpFormatter) -> None:
        with formatter.section("Commands"):
            formatter.write_dl(list(COMMANDS.items()))


def _print_version(ctx: click.Context, _param: click.Parameter, value: bool) -> None:
    if not value or ctx.resilient_parsing:
        return
    from importlib.metadata import version

    from pmbm.assignment import kernel

    click.echo(f"pmbm {version('pmbm')} ({kernel()} assignment kernel)")
    ctx.exit()


@click.group(cls=_LazyGroup, context_settings={"help_option_names": ["-h", "--help"]})
@click.option(
    "--version",
    is_flag=True,
    is_eager=True,
    expose_value=False,
    callback=_print_version,
    help="Show the version and exit.",
)
def group() -> None:
    """Prove a multi-object tracker in controlled traffic before it meets the road.

    \b
    Example:
      pmbm run truck_occlusion --trials 5
    """


def main(arguments: list[str] | None = None) -> Any:
    """The console script: runs a command and turns what a user can get wrong into one line."""
    from pmbm.errors import InputError, notes_of

    try:
        _refuse_missing_parts()
        with _warnings_in_a_line():
            code = group.main(args=arguments, prog_name="pmbm", standalone_mode=False)
    except InputError as error:
        _complain("\n".join([str(error), *notes_of(error)]))
        sys.exit(2)
    except click.exceptions.NoArgsIsHelpError as error:
        error.show()
        sys.exit(2)
    except click.ClickException as error:
        _complain(" ".join(error.format_message().split()))
        sys.exit(2)
    except (click.Abort, KeyboardInterrupt):
        _complain("stopped")
        sys.exit(INTERRUPTED)
    except OSError as error:
        # Places to write are the user's to choose; a place that refuses is bad input.
        what = error.strerror or str(error)
        _complain(f"{what}: {error.filename}" if error.filename else what)
        sys.exit(2)
    sys.exit(code if isinstance(code, int) else 0)


def _refuse_missing_parts() -> None:
    """Raise InputError where a checkout has files in place of its links to sim and reports."""
    from importlib.util import find_spec

    from pmbm.errors import InputError

    for name in ("pmbm.sim", "pmbm.reports"):
        if find_spec(name) is None:
            raise InputError(
                f"{name} is missing: this checkout has no symbolic links",
                hint="git config core.symlinks true, and check out again; or install a wheel",
            )


@contextmanager
def _warnings_in_a_line() -> Iterator[None]:
    """Show an InputWarning as one line, without the place in the code."""
    import warnings

    from pmbm.errors import InputWarning

    with warnings.catch_warnings():
        otherwise = warnings.showwarning

        def show(
            message: Warning | str, category: type[Warning], *where: Any, **details: Any
        ) -> None:
            if issubclass(category, InputWarning):
                _complain(f"warning: {message}")
            else:
                otherwise(message, category, *where, **details)

        warnings.showwarning = show
        yield


def _complain(text: str) -> None:
    click.echo(f"pmbm: {text}", err=True)


def warn(text: str) -> None:
    """Say on stderr, in a line, what is odd about what was asked for."""
    _complain(f"warning: {text}")
