"""`pmbm init`: a tracker's repository to begin with."""

from __future__ import annotations

from pathlib import Path

import click

_ELSEWHERE = {"ci.yml": ".github/workflows/tracking.yml"}
"""Files of the example that have their place elsewhere in a repository."""
_LEFT_BEHIND = {"__pycache__", ".pytest_cache", "reports", "pmbm-reports"}
_IGNORED = """\
# What pmbm and pytest leave behind.
__pycache__/
.pytest_cache/
/reports/
/pmbm-reports/
*.sqlite
*.sqlite-shm
*.sqlite-wal
*.sqlite.lock
"""


@click.command()
@click.argument(
    "folder", type=click.Path(path_type=Path, file_okay=False), default=Path("."), required=False
)
def command(folder: Path) -> None:
    """Write a tracker's repository into FOLDER (the current one): a tracker of forty lines, its
    scenario tests, a study, a gate, and the file for continuous integration.  Nothing that is there
    is touched.

    \b
    Example:
      pmbm init my_tracker
      cd my_tracker
      pytest
    """
    import pmbm
    from pmbm.durable import replace_text
    from pmbm.errors import InputError

    example = Path(pmbm.__file__).parent / "example"
    names = [file.relative_to(example) for file in sorted(example.rglob("*")) if file.is_file()]
    # Run in the repository, the example leaves behind what it ignores itself.
    own = [name for name in names if not {*name.parts[:-1]} & _LEFT_BEHIND]
    texts = {
        folder / _ELSEWHERE.get(str(name), name): (example / name).read_text(encoding="utf-8")
        for name in own
        if name.suffix in (".py", ".toml", ".yml", ".md")
    }
    texts[folder / ".gitignore"] = _IGNORED
    there = [file for file in texts if file.exists()]
    if there:
        raise InputError("it is there already", file=there[0], hint="name a new folder")
    for file, text in texts.items():
        file.parent.mkdir(parents=True, exist_ok=True)
        replace_text(file, text)
        click.echo(file)
