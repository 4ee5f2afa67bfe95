"""Scenes on disk, so that a study simulates the traffic of each trial once.

An entry's key covers all that its bits depend on: the scenario's scene, seed and trial, the code,
the versions of what computes, and the kind of processor.  A file holds the hash of its content
before the content; one that does not match is made again.  Writers never meet: each writes its own
file and renames it into place, and equal keys mean equal bits.
"""

from __future__ import annotations

import contextlib
import functools
import hashlib
import io
import itertools
import json
import os
import platform
import sys
import zipfile
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, fields
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from pmbm.durable import replace_bytes
from pmbm.errors import InputError
from pmbm.provenance import provenance
from pmbm.sim.world.scene import Scene
from pmbm.types import GroundTruth, Site, checked_rows, frames_of

LARGEST_BYTES = 2 * 1024**3
"""Beyond this the entries used longest ago are deleted."""

_FORMAT = 1
_HASH_BYTES = 32
_COLUMNS = tuple(f.name for f in fields(GroundTruth) if f.name != "time")
_writes = itertools.count(1)


@dataclass(frozen=True)
class Entry:
    """A file of the cache: one scene by scenario, seed and trial."""

    path: Path
    scenario: str
    seed: int
    trial: int
    bytes: int
    used: float
    """Time of last use, s since the epoch."""


def cache_folder() -> Path:
    """`PMBM_CACHE`, or the platform's folder for caches."""
    chosen = os.environ.get("PMBM_CACHE")
    if chosen:
        return Path(chosen)
    home = Path.home()
    if sys.platform == "darwin":
        parent = home / "Library" / "Caches"
    elif sys.platform == "win32":
        parent = Path(os.environ.get("LOCALAPPDATA", home / "AppData" / "Local"))
    else:
        parent = Path(os.environ.get("XDG_CACHE_HOME") or home / ".cache")
    return parent / "pmbm"


def cached(name: str, content: str, seed: int, trial: int, make: Callable[[], Scene]) -> Scene:
    """The scene of this content (JSON), seed and trial: from the cache, else from `make`.

    Raises InputError where `PMBM_CACHE` names a folder that cannot be written; the platform's own
    folder is done without where it cannot.
    """
    path = cache_folder() / f"{name}-{seed}-{trial}-{_key(content, seed, trial)}.npz"
    scene = _read(path)
    if scene is not None:
        return scene
    scene = make()
    try:
        _write(path, scene)
    except (OSError, InputError) as error:
        if os.environ.get("PMBM_CACHE"):
            raise InputError(
                "PMBM_CACHE cannot be written", file=cache_folder(), got=error
            ) from error
    return scene


def entries() -> Iterator[Entry]:
    """The entries of the cache, by name."""
    for path in sorted(cache_folder().glob("*-*-*-*.npz")):
        name, seed, trial, _ = path.stem.rsplit("-", 3)
        with contextlib.suppress(OSError, ValueError):
            found = path.stat()
            yield Entry(path, name, int(seed), int(trial), found.st_size, found.st_mtime)


def clear(chosen: Sequence[Entry]) -> int:
    """Delete entries; those that another process deleted first count too."""
    for entry in chosen:
        entry.path.unlink(missing_ok=True)
    return len(chosen)


@functools.cache
def bits_key() -> str:
    """Machines of equal keys compute equal bits: the platform, the versions of what computes, and
    a digest of what the functions that traffic and detectors are made of give here.

    Names of processor features do not do: a linear algebra library chooses its kernels by the
    processor's model, so that two machines with the same features differ in the last bits.
    """
    made_by = provenance()
    versions = made_by["versions"]
    python = ".".join(platform.python_version_tuple()[:2])
    parts = [made_by["platform"], f"python{python}"]
    parts += [f"{name}{versions[name]}" for name in ("numpy", "highway-env") if name in versions]
    return "-".join([*parts, _arithmetic()])


def _arithmetic() -> str:
    """Digest of the last bits of elementary functions, inner products and special functions."""
    from scipy import special

    x = np.linspace(-30.0, 30.0, 4001)
    share = np.linspace(0.001, 0.999, 999)
    digest = hashlib.sha256()
    for function in (np.sin, np.cos, np.tan, np.arctan, np.exp, special.expit, special.ndtr):
        digest.update(function(x).tobytes())
        digest.update(np.array([function(one) for one in x[::40]]).tobytes())
    for function in (np.arcsin, np.log, np.log1p, np.sqrt, special.ndtri, special.logit):
        digest.update(function(share).tobytes())
    for one, other in ((np.hypot, x[::-1]), (np.arctan2, x[::-1]), (np.add, 0.1)):
        digest.update(one(x, other).tobytes())
    digest.update(np.power(share, 1.7).tobytes())
    digest.update(special.betaincinv(2.5, 1.5, share).tobytes())
    for length in (2, 3, 4, 7, 16, 100):
        rows = np.sin(x[: 40 * length]).reshape(40, length)
        digest.update(
            np.array([np.dot(a, b) for a, b in zip(rows, rows[::-1], strict=True)]).tobytes()
        )
        digest.update(np.linalg.norm(rows, axis=1).tobytes())
        digest.update(np.array([np.linalg.norm(row) for row in rows]).tobytes())
        digest.update((rows @ rows.T).tobytes())
    return digest.hexdigest()[:12]


def _key(content: str, seed: int, trial: int) -> str:
    worlds = provenance()["versions"].get("gymnasium")
    parts = json.dumps([_FORMAT, _code_hash(), bits_key(), worlds, content, seed, trial])
    return hashlib.sha256(parts.encode()).hexdigest()[:32]


@functools.cache
def _code_hash() -> str:
    """A hash of every source file that a scene may depend on."""
    from pmbm import geometry, labels, types, validation

    files = sorted(Path(__file__).parent.parent.rglob("*.py"))
    files += [Path(str(module.__file__)) for module in (geometry, labels, types, validation)]
    hasher = hashlib.sha256()
    for file in files:
        hasher.update(file.name.encode() + file.read_bytes())
    return hasher.hexdigest()


def _read(path: Path) -> Scene | None:
    """The scene in a file, or None where there is none or it is not what was written."""
    try:
        content = path.read_bytes()
    except OSError:
        return None
    check, body = content[:_HASH_BYTES], content[_HASH_BYTES:]
    if hashlib.sha256(body).digest() != check:
        return None
    with np.load(io.BytesIO(body), allow_pickle=False) as arrays:
        scene = _unpacked(dict(arrays))
    with contextlib.suppress(OSError):
        os.utime(path)
    return scene


def _write(path: Path, scene: Scene) -> None:
    buffer = io.BytesIO()
    with zipfile.ZipFile(buffer, "w", zipfile.ZIP_STORED) as archive:
        for name, array in _packed(scene).items():
            # The archive's own date would make equal scenes unequal files.
            member = zipfile.ZipInfo(f"{name}.npy", (1980, 1, 1, 0, 0, 0))
            with archive.open(member, "w") as stream:
                np.lib.format.write_array(stream, array, allow_pickle=False)
    body = buffer.getvalue()
    path.parent.mkdir(parents=True, exist_ok=True)
    replace_bytes(path, hashlib.sha256(body).digest() + body)
    if next(_writes) % 100 == 0:
        _shrink()


def _shrink() -> None:
    held = sorted(entries(), key=lambda entry: entry.used)
    excess = sum(entry.bytes for entry in held) - LARGEST_BYTES
    for entry in held:
        if excess <= 0:
            return
        entry.path.unlink(missing_ok=True)
        excess -= entry.bytes


def _packed(scene: Scene) -> dict[str, NDArray[Any]]:
    """Flat arrays of a scene: the frames' rows one after the other, and the rest as JSON."""
    frames, site = scene.truth, scene.site
    about = {
        "name": scene.name,
        "rate": scene.rate,
        "object_name": list(scene.object_name.items()),
        "provenance": dict(scene.provenance),
        "fov_centre": site.fov_centre,
        "fov_half_angle": site.fov_half_angle,
        "max_range": site.max_range,
        "drivable": site.drivable_area is not None,
        "occluders": len(site.occluders),
    }
    polygons = (*site.occluders, *(site.drivable_area or ()))
    packed: dict[str, NDArray[Any]] = {
        "about": np.frombuffer(json.dumps(about).encode(), np.uint8),
        "count": np.array([len(frame) for frame in frames], np.int64),
        "time": np.array([frame.time for frame in frames], np.float64),
        "sensor_pose": scene.sensor_pose,
        "stamp": scene.stamp,
        "corner_count": np.array([len(polygon) for polygon in polygons], np.int64),
        "corners": np.concatenate([*polygons, np.zeros((0, 2))]),
    }
    for name in _COLUMNS:
        packed[name] = np.concatenate([getattr(frame, name) for frame in frames])
    return packed


def _unpacked(arrays: dict[str, NDArray[Any]]) -> Scene:
    about = json.loads(arrays["about"].tobytes())
    columns = {name: arrays[name] for name in _COLUMNS}
    time, count = arrays["time"].tolist(), arrays["count"]
    polygons = np.split(arrays["corners"], np.cumsum(arrays["corner_count"]))[:-1]
    occluders = about["occluders"]
    return Scene(
        name=about["name"],
        site=Site(
            occluders=tuple(polygons[:occluders]),
            fov_centre=about["fov_centre"],
            fov_half_angle=about["fov_half_angle"],
            max_range=about["max_range"],
            drivable_area=tuple(polygons[occluders:]) if about["drivable"] else None,
        ),
        truth=frames_of(GroundTruth, time, count, checked_rows(GroundTruth, time, count, columns)),
        sensor_pose=arrays["sensor_pose"],
        stamp=arrays["stamp"],
        rate=about["rate"],
        object_name={int(key): name for key, name in about["object_name"]},
        provenance=about["provenance"],
    )
