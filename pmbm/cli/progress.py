"""How far a command is: a bar on a terminal, which is gone afterwards; nothing where there is
none."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from rich.progress import Progress, ProgressColumn


@contextmanager
def bar(*columns: str | ProgressColumn, quiet: bool = False) -> Iterator[Progress]:
    """rich's progress display on stderr, with its own columns where none is named."""
    from rich.console import Console
    from rich.progress import Progress

    console = Console(stderr=True)
    hidden = quiet or not console.is_terminal
    with Progress(*columns, console=console, transient=True, disable=hidden) as shown:
        yield shown


def spread(
    function: Callable[..., Any], tasks: Sequence[tuple[Any, ...]], jobs: int, what: str
) -> Iterator[Any]:
    """`function` of each task, in order, over `jobs` processes, with a bar."""
    from rich.progress import SpinnerColumn, TextColumn, TimeElapsedColumn

    columns = (SpinnerColumn(), TextColumn("{task.completed}/{task.total} {task.description}"))
    with bar(*columns, TimeElapsedColumn()) as progress:
        task = progress.add_task(what, total=len(tasks))
        for result in _results(function, tasks, jobs):
            progress.advance(task)
            yield result


def _results(
    function: Callable[..., Any], tasks: Sequence[tuple[Any, ...]], jobs: int
) -> Iterator[Any]:
    if min(jobs, len(tasks)) <= 1:
        yield from (function(*task) for task in tasks)
        return
    from pmbm.study.parallel import workers

    with workers(min(jobs, len(tasks))) as pool:
        yield from (future.result() for future in [pool.submit(function, *t) for t in tasks])
