"""A cache of stage results that runs share: a store that many processes can read and write at the same time.

A run keeps its results in a store of its own. It takes results with the same key from the cache and adds its own, as
hard links if both are on one disk. A run never depends on its cache: if that is damaged, full, read-only or missing,
the stage is run.
"""

from __future__ import annotations

import os
import re
import time
from collections import Counter
from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager, suppress
from dataclasses import dataclass
from pathlib import Path
from typing import TypeVar

from filelock import FileLock

from scaffold_pipeline.errors import ConfigError, Fault
from scaffold_pipeline.runs.store import DamagedStoreError, Store

FOLDER_VARIABLE = "SCAFFOLD_PIPELINE_CACHE"
"""Environment variable with the folder of the cache for every run and study."""

LIMIT_VARIABLE = "SCAFFOLD_PIPELINE_CACHE_LIMIT"
"""Environment variable with the size limit of that cache."""

DEFAULT_LIMIT = "20 GB"

_ORPHAN_AGE = 3600.0
"""Seconds after which a file that no result needs is deleted: a newer one may belong to a result being stored."""

_UNITS = {"B": 1, "KB": 10**3, "MB": 10**6, "GB": 10**9, "TB": 10**12}
_SIZE = re.compile(r"(\d+(?:\.\d+)?)\s*([KMGT]?B)", re.IGNORECASE)

Written = TypeVar("Written")


@dataclass(frozen=True)
class Entry:
    """One result in a cache: the bytes of each of its files, and the time of its last use, seconds since 1970."""

    key: str
    stage: str
    version: int
    seconds: float
    files: Mapping[Path, int]
    used: float


def parse_size(text: str, source: str) -> int:
    """Return the number of bytes in a text such as `20 GB`; raises `ConfigError` at `source` for any other text.

    >>> [parse_size(text, "--keep") for text in ("0B", "1.5 kB", "20GB")]
    [0, 1500, 20000000000]
    """
    match = _SIZE.fullmatch(text.strip())
    if match is None:
        raise ConfigError([Fault(0, 0, f"must be a size such as 500 MB or 20 GB, got {text!r}", source)])
    return round(float(match[1]) * _UNITS[match[2].upper()])


def choose_cache(folder: str | Path | None) -> Cache | None:
    """Return the cache in `folder`, or the one that the environment names, with the limit given there, or None."""
    chosen = folder or os.environ.get(FOLDER_VARIABLE)
    if not chosen:
        return None
    limit = parse_size(os.environ.get(LIMIT_VARIABLE) or DEFAULT_LIMIT, LIMIT_VARIABLE)
    return Cache(Path(chosen).expanduser().absolute(), limit)


class Cache:
    """A cache in the folder `root`, created with the first result; `prune` keeps at most `limit` bytes."""

    def __init__(self, root: Path, limit: int | None = None) -> None:
        self.root = root
        self.limit = limit
        self.store = Store(root)

    def lock(self, key: str) -> FileLock:
        """Wait until no other process works on `key`, and return its lock; the system releases those of dead processes.

        Raises `OSError` or `NotImplementedError` if the folder is read-only or does not support locks.
        """
        lock = self._lock(key)
        lock.parent.mkdir(parents=True, exist_ok=True)
        held = FileLock(lock)
        held.acquire()
        return held

    def fetch(self, key: str, store: Store) -> bool:
        """Copy the result of `key` to `store`; return whether there is one.

        A damaged result is deleted and raises `DamagedStoreError`.
        """
        try:
            result = self.store.result(key)
            if result is None:
                return False
            self.store.require_whole(result)
        except DamagedStoreError:
            with suppress(OSError):
                self.store.forget(key)
            raise
        self.store.share(key, store)
        with suppress(OSError):
            os.utime(self.store.path("results", key))  # the time of its last use
        return True

    def publish(self, key: str, store: Store) -> None:
        """Add the result of `key` in `store` to the cache; raises `OSError` if the folder cannot be written."""
        self.store.make_folders()
        store.share(key, self.store)

    def entries(self) -> list[Entry]:
        """Return all results, the most recently used first."""
        entries = []
        for key in self.store.stored_keys():
            with suppress(DamagedStoreError, OSError):
                result = self.store.result(key)
                if result is not None:
                    files = {path: path.stat().st_size for path in self.store.paths(key, result)}
                    used = self.store.path("results", key).stat().st_mtime
                    entries.append(Entry(key, result["stage"], result["version"], result["seconds"], files, used))
        return sorted(entries, key=lambda entry: entry.used, reverse=True)

    def size(self) -> int:
        """Return the size of all results, bytes."""
        return sum(_size(path) for path in self.store.root.rglob("*"))

    def prune(self, limit: int | None = None) -> int:
        """Delete the least recently used results until at most `limit` bytes are left; return the bytes freed."""
        limit = self.limit if limit is None else limit
        if limit is None or not self.root.is_dir():
            return 0
        self.store.make_folders()
        before, entries = self.size(), self.entries()
        needed = Counter(path for entry in entries for path in entry.files)
        left = sum({path: size for entry in entries for path, size in entry.files.items()}.values())
        while entries and left > limit:
            oldest = entries.pop()
            needed.subtract(oldest.files.keys())
            for path in [path for path in oldest.files if not needed[path]]:
                left -= oldest.files[path]
                path.unlink(missing_ok=True)
            self._lock(oldest.key).unlink(missing_ok=True)
        now = time.time()
        self.store.keep_only((entry.key for entry in entries), spare_newer_than=now - _ORPHAN_AGE)
        return before - self.size()

    def _lock(self, key: str) -> Path:
        return self.root / "locks" / f"{key}.lock"


class CacheClient:
    """One run's access to a cache, or to none: faults of the cache are passed to `warn`, and the run continues."""

    def __init__(self, cache: Cache | None, store: Store, warn: Callable[[str], None]) -> None:
        self._cache = cache
        self._store = store
        self._warn = warn
        self._may_write = True

    @contextmanager
    def lock(self, key: str) -> Iterator[None]:
        """Let only one run at a time work on `key`, if the cache can be written."""
        lock = self._attempt(lambda cache: cache.lock(key))
        try:
            yield
        finally:
            if lock is not None:
                lock.release()

    def fetch(self, key: str) -> bool:
        """Copy the cache's result of `key` to the run's store; return whether there was an undamaged one."""
        if self._cache is None:
            return False
        try:
            return self._cache.fetch(key, self._store)
        except (DamagedStoreError, OSError) as error:
            self._warn(f"cache {self._cache.root}: {error}; the stage is run again")
            return False

    def publish(self, key: str) -> None:
        """Add the result of `key` in the run's store to the cache."""
        self._attempt(lambda cache: cache.publish(key, self._store))

    def _attempt(self, write: Callable[[Cache], Written]) -> Written | None:
        """Return `write(cache)`; None without a cache, and after its first failure."""
        if self._cache is None or not self._may_write:
            return None
        try:
            return write(self._cache)
        except (OSError, NotImplementedError) as error:
            self._may_write = False
            reason = error.strerror if isinstance(error, OSError) and error.strerror else error
            self._warn(f"cache {self._cache.root}: cannot be written ({reason}); results stay in the run's own folder")
            return None


def _size(path: Path) -> int:
    with suppress(OSError):
        return path.stat().st_size if path.is_file() else 0
    return 0
