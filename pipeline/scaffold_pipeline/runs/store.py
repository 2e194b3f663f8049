"""Artifacts and files on disk, addressed by the hash of their content.

    arrays/HASH.npy   artifacts/HASH.json   files/HASH   results/KEY.json

An artifact is a JSON manifest of its values and the hashes of its arrays; a result lists the artifact and the files
that a stage made for one key. Everything is written under a temporary name and renamed, and hashed when read.
"""

from __future__ import annotations

import json
import math
import os
import shutil
import time
from collections.abc import Callable, Iterable, Mapping
from contextlib import suppress
from dataclasses import fields
from hashlib import file_digest, sha256
from importlib import import_module
from pathlib import Path
from typing import Any, BinaryIO, Literal
from uuid import uuid4

import numpy as np
from numpy.typing import NDArray

from scaffold_pipeline import artifacts
from scaffold_pipeline.artifacts import Artifact
from scaffold_pipeline.errors import PipelineError

OUT_PREFIX = ".out-"
"""Prefix of the folders that stages write their files to."""


_KINDS = {"arrays": ".npy", "artifacts": ".json", "files": "", "results": ".json"}
"""The folders of a store, and the suffix of the files in each."""

_SETTLED_AFTER = 2.0
"""Seconds after the last change of a file: a later change has a different time stamp, even on FAT."""

_INPUT_HASHES: dict[tuple[Path, int, int, int], str] = {}


class DamagedStoreError(PipelineError):
    """Something in the store is missing, or does not have the recorded hash."""


def canonical_json(value: object) -> str:
    """Return the canonical JSON text of `value`: sorted keys, no spaces, no NaN."""
    return json.dumps(value, sort_keys=True, separators=(",", ":"), allow_nan=False, ensure_ascii=False)


def hash_json(value: object) -> str:
    """Return the SHA-256 of the canonical JSON of `value`."""
    return sha256(canonical_json(value).encode()).hexdigest()


def hash_file(path: Path) -> str:
    """Return the SHA-256 of a file's content."""
    with path.open("rb") as stream:
        return file_digest(stream, "sha256").hexdigest()


def hash_input(path: Path) -> str:
    """Return `hash_file` of an input file; an unchanged file is read once, however often its hash is needed."""
    state = path.stat()
    seen = (path, state.st_ino, state.st_size, state.st_mtime_ns)
    is_settled = time.time() - state.st_mtime > _SETTLED_AFTER
    if not is_settled or seen not in _INPUT_HASHES:
        digest = hash_file(path)
        if not is_settled:
            return digest
        _INPUT_HASHES[seen] = digest
    return _INPUT_HASHES[seen]


def write_atomically(path: Path, write: Callable[[BinaryIO], object]) -> None:
    """Let `write` fill a temporary file, then rename it to `path`: that is complete, or is not changed."""
    partial = path.with_name(f".partial-{uuid4().hex}")
    try:
        with partial.open("xb") as stream:
            write(stream)
        partial.replace(path)
    finally:
        partial.unlink(missing_ok=True)


def _link(source: Path, target: Path) -> None:
    """Make `target` a hard link to `source`, or a copy if they are on two disks."""
    partial = target.with_name(f".partial-{uuid4().hex}")
    try:
        try:
            os.link(source, partial)
        except OSError:  # two disks, or one that has no hard links
            shutil.copyfile(source, partial)
        partial.replace(target)
    finally:
        partial.unlink(missing_ok=True)  # renaming leaves it if both were the same file already


class Store:
    """The folder of a run's intermediate results."""

    def __init__(self, root: Path) -> None:
        self.root = root

    def prepare(self) -> None:
        """Make the store's folders and remove leftovers of a killed run; only while the run directory is locked."""
        self.make_folders()
        for leftover in self.root.glob(f"{OUT_PREFIX}*"):
            shutil.rmtree(leftover, ignore_errors=True)
        for kind in _KINDS:
            for leftover in (self.root / kind).glob(".partial-*"):
                leftover.unlink(missing_ok=True)

    def make_folders(self) -> None:
        """Make the store's folders."""
        for name in _KINDS:
            (self.root / name).mkdir(parents=True, exist_ok=True)

    def save(self, artifact: Artifact) -> str:
        """Store an artifact and return its hash."""
        manifest = self._manifest(artifact)
        digest = hash_json(manifest)
        text = canonical_json(manifest).encode()
        write_atomically(self.path("artifacts", digest), lambda stream: stream.write(text))
        return digest

    def load(self, digest: str) -> Artifact:
        """Load an artifact; raises `DamagedStoreError` if it is damaged."""
        manifest = self._read_manifest(digest)
        try:
            return self._restore(manifest)
        except DamagedStoreError:
            raise
        except (ImportError, AttributeError, TypeError, PipelineError) as error:  # its type has changed since
            raise DamagedStoreError(f"stored artifact {digest[:12]} cannot be loaded ({error})") from error

    def save_file(self, path: Path) -> str:
        """Store a copy of a file and return its hash."""
        digest = hash_file(path)
        with path.open("rb") as source:
            write_atomically(self.path("files", digest), lambda stream: shutil.copyfileobj(source, stream))
        return digest

    def copy_file(self, digest: str, target: Path) -> None:
        """Write the stored file to `target`; raises `DamagedStoreError` if it is damaged."""
        self._require_file(digest)
        shutil.copyfile(self.path("files", digest), target)

    def result(self, key: str) -> dict[str, Any] | None:
        """Return the result stored for `key`, or None.

        Raises `DamagedStoreError` if it, its artifact or one of its files is damaged. Arrays are only required to
        exist: they are hashed when they are loaded.
        """
        path = self.path("results", key)
        if not path.exists():
            return None
        try:
            stored = json.loads(path.read_text(encoding="utf-8"))
            result: dict[str, Any] = stored["result"]
            is_whole = stored["sha256"] == hash_json(result)
        except (OSError, ValueError, KeyError, TypeError) as error:
            raise DamagedStoreError(f"stored result {key[:12]} cannot be read") from error
        if not is_whole:
            raise DamagedStoreError(f"stored result {key[:12]} is not what was stored")
        for digest in _array_hashes(self._read_manifest(result["output"])):
            if not self.path("arrays", digest).exists():
                raise DamagedStoreError(f"stored array {digest[:12]} is missing")
        for digest in result["files"].values():
            self._require_file(digest)
        return result

    def save_result(self, key: str, result: Mapping[str, Any]) -> None:
        """Store the result of a stage for `key`: at least `output` and `files`, which are in the store already."""
        text = canonical_json({"result": result, "sha256": hash_json(result)}).encode()
        write_atomically(self.path("results", key), lambda stream: stream.write(text))

    def forget(self, key: str) -> None:
        """Delete the result of `key`."""
        self.path("results", key).unlink(missing_ok=True)

    def stored_keys(self) -> list[str]:
        """Return the keys of all results."""
        return sorted(path.stem for path in (self.root / "results").glob("*.json"))

    def require_whole(self, result: Mapping[str, Any]) -> None:
        """Require that the arrays of a result have their hashes; raises `DamagedStoreError` if one is damaged."""
        for digest in _array_hashes(self._read_manifest(result["output"])):
            self._load_array(digest, mmap_mode="r")

    def share(self, key: str, other: Store) -> None:
        """Copy the result of `key` and everything it needs to `other`: as hard links if both are on one disk."""
        result = self.result(key)
        for path in self.paths(key, result) if result else ():
            _link(path, other.root / path.relative_to(self.root))

    def paths(self, key: str, result: Mapping[str, Any]) -> list[Path]:
        """Return the paths of everything that the `result` of `key` needs, its own file last."""
        arrays = _array_hashes(self._read_manifest(result["output"]))
        return [
            *(self.path("arrays", digest) for digest in dict.fromkeys(arrays)),
            *(self.path("files", digest) for digest in dict.fromkeys(result["files"].values())),
            self.path("artifacts", result["output"]),
            self.path("results", key),
        ]

    def keep_only(self, keys: Iterable[str], *, spare_newer_than: float = math.inf) -> None:
        """Delete every result except those of `keys`, and all files that only the deleted ones needed.

        A file that no result needs is kept if it is newer than `spare_newer_than`, seconds since 1970: another process
        may be storing the result that needs it.
        """
        kept = {key: result for key in keys if (result := self.result(key))}
        wanted = {path for key, result in kept.items() for path in self.paths(key, result)}
        for path in [path for kind in _KINDS for path in (self.root / kind).iterdir() if path not in wanted]:
            with suppress(FileNotFoundError):
                if path.parent.name == "results" or path.stat().st_ctime <= spare_newer_than:
                    path.unlink()

    def path(self, kind: str, digest: str) -> Path:
        """Return the path of the entry with that hash or key in the folder `kind`."""
        return self.root / kind / f"{digest}{_KINDS[kind]}"

    def _read_manifest(self, digest: str) -> dict[str, Any]:
        try:
            manifest: dict[str, Any] = json.loads(self.path("artifacts", digest).read_text(encoding="utf-8"))
        except (OSError, ValueError) as error:
            raise DamagedStoreError(f"stored artifact {digest[:12]} cannot be read") from error
        if hash_json(manifest) != digest:
            raise DamagedStoreError(f"stored artifact {digest[:12]} is not what was stored")
        return manifest

    def _require_file(self, digest: str) -> None:
        stored = self.path("files", digest)
        if not stored.is_file() or hash_file(stored) != digest:
            raise DamagedStoreError(f"stored file {digest[:12]} is missing or damaged")

    def _manifest(self, artifact: Artifact) -> dict[str, Any]:
        """Store the arrays of `artifact` and return the manifest from which it can be loaded."""
        entries = {entry.name: self._entry(getattr(artifact, entry.name)) for entry in fields(artifact)}
        return {"type": _type_name(type(artifact)), "fields": entries}

    def _entry(self, value: object) -> dict[str, Any]:
        if isinstance(value, np.ndarray):
            digest = hash_array(value)
            path = self.path("arrays", digest)
            write_atomically(path, lambda stream: np.save(stream, value, allow_pickle=False))
            return {"array": digest}
        if isinstance(value, Artifact):
            return {"artifact": self._manifest(value)}
        if isinstance(value, tuple) and value and all(isinstance(entry, Artifact) for entry in value):
            return {"artifacts": [self._manifest(entry) for entry in value]}
        if isinstance(value, tuple):
            return {"tuple": list(value)}
        return {"value": dict(value) if isinstance(value, Mapping) else value}

    def _restore(self, manifest: dict[str, Any]) -> Artifact:
        module, _, name = manifest["type"].partition(":")
        kind = getattr(import_module(module), name)
        if not (isinstance(kind, type) and issubclass(kind, Artifact)):
            raise DamagedStoreError(f"stored type {manifest['type']!r} is not an artifact")
        return kind(**{name: self._restore_entry(entry) for name, entry in manifest["fields"].items()})

    def _restore_entry(self, entry: dict[str, Any]) -> Any:  # noqa: ANN401 - whatever the field holds
        if "array" in entry:
            return self._load_array(entry["array"])
        if "artifact" in entry:
            return self._restore(entry["artifact"])
        if "artifacts" in entry:
            return tuple(self._restore(manifest) for manifest in entry["artifacts"])
        return tuple(entry["tuple"]) if "tuple" in entry else entry["value"]

    def _load_array(self, digest: str, mmap_mode: Literal["r"] | None = None) -> NDArray[Any]:
        try:
            values: NDArray[Any] = np.load(self.path("arrays", digest), mmap_mode=mmap_mode, allow_pickle=False)
        except MemoryError:
            raise
        except Exception as error:  # a broken header can make numpy raise any exception
            raise DamagedStoreError(f"stored array {digest[:12]} cannot be read") from error
        if hash_array(values) != digest:
            raise DamagedStoreError(f"stored array {digest[:12]} is not what was stored")
        values.setflags(write=False)
        return values


def first_result(stores: Iterable[Store], key: str) -> dict[str, Any] | None:
    """Return the result of `key` from the first of `stores` that has it undamaged, or None."""
    for store in stores:
        with suppress(DamagedStoreError):
            stored = store.result(key)
            if stored is not None:
                return stored
    return None


def _type_name(kind: type[Artifact]) -> str:
    """Return the name under which `kind` is stored: its public one, which does not change if a module is moved."""
    is_public = getattr(artifacts, kind.__name__, None) is kind
    return f"{artifacts.__name__ if is_public else kind.__module__}:{kind.__qualname__}"


def hash_array(values: NDArray[Any]) -> str:
    """Return the SHA-256 of an array's type, shape and content."""
    digest = sha256(f"{values.dtype.str}{values.shape}".encode())
    digest.update(np.ascontiguousarray(values).data)
    return digest.hexdigest()


def _array_hashes(manifest: dict[str, Any]) -> list[str]:
    entries = manifest["fields"].values()
    own = [entry["array"] for entry in entries if "array" in entry]
    nested = [manifest for entry in entries for manifest in entry.get("artifacts", [entry.get("artifact")]) if manifest]
    return own + [digest for manifest in nested for digest in _array_hashes(manifest)]
