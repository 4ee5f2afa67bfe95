"""Files that are written whole or not at all, over full disks, kills and power cuts."""

from __future__ import annotations

import os
import secrets
from pathlib import Path

from pmbm.errors import InputError


def replace_text(path: Path, text: str) -> None:
    """`replace_bytes` with a text as UTF-8."""
    replace_bytes(path, text.encode("utf-8"))


def replace_bytes(path: Path, content: bytes) -> None:
    """Write a whole file, or leave what was there.

    The content is written beside the file under a name of its own, flushed to the disk, and renamed
    over it.  Links are followed, permissions kept.  What is no file (a device, a pipe) is written
    to as it is.

    Raises InputError where it cannot be written.
    """
    try:
        _replace(path, content)
    except OSError as error:
        raise InputError(
            f"cannot write: {error.strerror}",
            file=path,
            hint="what was there is as it was" if os.path.exists(path) else None,
        ) from error


def check_writable(path: Path) -> None:
    """Raise InputError where `replace_bytes` would, short of a full disk; makes missing folders.

    For before long work, so that its end has a place.
    """
    try:
        path.parent.mkdir(parents=True, exist_ok=True)
        if path.is_dir():
            raise IsADirectoryError(None, "Is a directory")
        if not _is_special(path):
            own, descriptor = _beside(path.resolve())
            os.close(descriptor)
            own.unlink()
    except OSError as error:
        raise InputError(
            f"cannot write there: {error.strerror}", file=path, hint="name another place"
        ) from error


def _replace(path: Path, content: bytes) -> None:
    if _is_special(path):
        path.write_bytes(content)
        return
    path = path.resolve()
    own, descriptor = _beside(path)
    try:
        with os.fdopen(descriptor, "wb") as stream:
            if path.exists():
                os.chmod(own, path.stat().st_mode & 0o7777)
            stream.write(content)
            stream.flush()
            os.fsync(descriptor)
        os.replace(own, path)
    except BaseException:
        own.unlink(missing_ok=True)
        raise
    if os.name != "posix":
        return
    # The new name is on the disk once the folder is.
    folder = os.open(path.parent, os.O_RDONLY)
    try:
        os.fsync(folder)
    finally:
        os.close(folder)


def _beside(path: Path) -> tuple[Path, int]:
    """A new file in the same folder, and its descriptor; no other writer has the name."""
    own = path.with_name(f".{secrets.token_hex(8)}.part")
    binary = getattr(os, "O_BINARY", 0)
    return own, os.open(own, os.O_WRONLY | os.O_CREAT | os.O_EXCL | binary, 0o666)


def _is_special(path: Path) -> bool:
    return path.exists() and not path.is_file() and not path.is_dir()
