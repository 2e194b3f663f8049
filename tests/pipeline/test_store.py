from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest

from pipeline.workplace import harm
from scaffold_pipeline.artifacts import (
    Artifact,
    Certificate,
    Finding,
    Histogram,
    Metrics,
    OuterShape,
    ScalarField,
    VolumeMesh,
)
from scaffold_pipeline.runs.store import (
    DamagedStoreError,
    Store,
    canonical_json,
    hash_array,
    hash_file,
    write_atomically,
)

CORNERS = np.array([[0.0, 0.0, 0.0], [1.0, 0.0, 0.0], [0.0, 1.0, 0.0], [0.0, 0.0, 1.0]])
OUTWARD = np.array([[0, 2, 1], [0, 1, 3], [1, 2, 3], [2, 0, 3]])
SHAPE = OuterShape(CORNERS, OUTWARD, notes=("clean", "turned"))
FIELD = ScalarField(
    np.linspace(-1.0, 1.0, 24).reshape(2, 3, 4),
    np.array([0.1, 0.2, 0.3]),
    0.5,
    Certificate(np.array([0.1]), np.array([0.2, 0.3])),
    {"basis": "gaussian", "supports": 3, "exact": False, "limit": None},
)
MEASURED = Metrics(
    {},
    histograms=(Histogram("strut", "Struts", "mm", np.array([0.0, 1.0, 2.0]), np.array([0.25, 0.75])),),
    findings=(Finding("overhang", "hangs", np.array([[1.0, 2.0, 3.0]])), Finding("size", "too large")),
)
EACH = [
    SHAPE,
    FIELD,
    VolumeMesh(CORNERS, np.array([[0, 1, 2, 3]])),
    Metrics({"porosity": 0.1 + 0.2}, ("a", "b")),
    MEASURED,
]


@pytest.fixture
def store(tmp_path: Path) -> Store:
    store = Store(tmp_path / "store")
    store.prepare()
    return store


def content(value: object) -> object:
    if isinstance(value, Artifact):
        return {name: content(part) for name, part in vars(value).items()}
    if isinstance(value, tuple):
        return [content(part) for part in value]
    return (value.dtype.str, value.tolist()) if isinstance(value, np.ndarray) else value


@pytest.mark.parametrize("artifact", EACH, ids=lambda artifact: type(artifact).__name__)
def test_an_artifact_comes_back_as_it_was(store: Store, artifact: Artifact):
    digest = store.save(artifact)
    restored = store.load(digest)
    assert type(restored) is type(artifact)
    assert content(restored) == content(artifact)
    assert store.save(restored) == digest


def test_restored_arrays_are_locked(store: Store):
    restored = store.load(store.save(SHAPE))
    assert isinstance(restored, OuterShape)
    assert not restored.vertices.flags.writeable


def test_a_hash_depends_on_type_shape_and_content_but_not_on_layout():
    numbers = np.arange(6.0)
    hashes = {
        hash_array(array) for array in (numbers, numbers.reshape(2, 3), numbers.astype(np.float32), numbers + 1.0)
    }
    assert len(hashes) == 4
    assert hash_array(np.asfortranarray(numbers.reshape(2, 3))) == hash_array(numbers.reshape(2, 3))
    assert hash_array(np.empty((0, 3))) != hash_array(np.empty((0, 4)))


def test_canonical_json_is_one_text_and_refuses_what_json_cannot_hold():
    assert canonical_json({"b": [1, 2.5], "a": "é"}) == canonical_json({"a": "é", "b": (1, 2.5)})
    with pytest.raises(ValueError, match="not JSON compliant"):
        canonical_json({"a": float("nan")})


def test_a_file_comes_back_as_it_was(store: Store, tmp_path: Path):
    (tmp_path / "solid.stl").write_bytes(b"solid")
    store.copy_file(store.save_file(tmp_path / "solid.stl"), tmp_path / "copy.stl")
    assert (tmp_path / "copy.stl").read_bytes() == b"solid"


def stored_run(store: Store, tmp_path: Path) -> tuple[str, Path, Path, Path, Path]:
    """Store one result; return its hash and the paths of its result, artifact, array and file."""
    (tmp_path / "solid.stl").write_bytes(b"solid")
    output = store.save(Certificate(np.array([0.5]), np.array([0.5])))
    file = store.save_file(tmp_path / "solid.stl")
    store.save_result("key", {"output": output, "files": {"solid.stl": file}, "label": "make"})
    (array,) = (store.root / "arrays").iterdir()
    root = store.root
    return output, root / "results/key.json", root / f"artifacts/{output}.json", array, root / f"files/{file}"


def test_a_result_is_given_back_while_it_is_whole(store: Store, tmp_path: Path):
    output, *_ = stored_run(store, tmp_path)
    result = store.result("key")
    assert result is not None
    assert (result["output"], result["label"]) == (output, "make")
    assert store.result("other") is None


@pytest.mark.parametrize("part", [1, 2, 3, 4], ids=["result", "artifact", "array", "file"])
@pytest.mark.parametrize("how", ["empty", "half", "bit", "gone"])
def test_every_harm_to_a_result_is_seen(store: Store, tmp_path: Path, part: int, how: str):
    run = stored_run(store, tmp_path)
    output, path = run[0], run[part]
    assert isinstance(path, Path)
    harm(path, how)
    if path.parent.name == "results" and how == "gone":
        assert store.result("key") is None
        return
    with pytest.raises(DamagedStoreError, match=r"stored (result|artifact|array|file) "):
        store.load(output) if store.result("key") else None


@pytest.mark.parametrize("bit", [0, 3, 7])
def test_no_flipped_bit_of_an_array_file_changes_what_is_loaded(store: Store, bit: int):
    artifact = Certificate(np.array([0.5]), np.array([0.5]))
    digest = store.save(artifact)
    (path,) = (store.root / "arrays").iterdir()
    whole = path.read_bytes()
    seen = 0
    for place in range(len(whole)):
        path.write_bytes(whole[:place] + bytes([whole[place] ^ (1 << bit)]) + whole[place + 1 :])
        try:
            loaded = store.load(digest)
        except DamagedStoreError:
            seen += 1
        else:
            assert content(loaded) == content(artifact)
    assert seen > len(whole) // 3


@pytest.mark.parametrize("text", ["3", "null", "[]", '{"result": 3}', '{"result": {}, "sha256": 1}', "\x00"])
def test_a_result_of_another_kind_is_damage(store: Store, text: str):
    (store.root / "results" / "key.json").write_text(text)
    with pytest.raises(DamagedStoreError, match="stored result key"):
        store.result("key")


def test_what_an_earlier_version_stored_and_this_one_cannot_make_is_damage(
    store: Store, monkeypatch: pytest.MonkeyPatch
):
    digest = store.save(SHAPE)
    manifest = json.loads((store.root / f"artifacts/{digest}.json").read_text())
    changes = [
        {**manifest, "type": "no_such_module:OuterShape"},
        {**manifest, "type": "scaffold_pipeline.artifacts.meshes:NoSuchShape"},
        {**manifest, "type": "pathlib:Path"},
        {**manifest, "fields": {**manifest["fields"], "colour": {"value": "red"}}},
        {**manifest, "fields": {"notes": manifest["fields"]["notes"]}},
    ]
    for changed in changes:
        monkeypatch.setattr(store, "_read_manifest", lambda _, changed=changed: changed)
        with pytest.raises(DamagedStoreError):
            store.load(digest)


def test_only_the_results_that_are_kept_and_what_they_need_stay(store: Store, tmp_path: Path):
    stored_run(store, tmp_path)
    store.save_result("other", {"output": store.save(FIELD), "files": {}})
    before = sum(path.is_file() for path in store.root.rglob("*"))
    store.keep_only(["key"])
    assert store.result("other") is None
    assert store.result("key") is not None
    kept = [path.parent.name for path in store.root.rglob("*") if path.is_file()]
    assert sorted(kept) == ["arrays", "artifacts", "files", "results"]
    assert before > len(kept)


def test_the_arrays_of_an_artifact_within_an_artifact_are_kept(store: Store):
    store.save_result("key", {"output": store.save(FIELD), "files": {}})
    store.keep_only(["key"])
    result = store.result("key")
    assert result is not None
    assert content(store.load(result["output"])) == content(FIELD)


def test_a_file_is_written_whole_or_not_at_all(tmp_path: Path):
    path = tmp_path / "metrics.json"
    write_atomically(path, lambda stream: stream.write(b"old"))

    def break_off(stream: object) -> None:
        stream.write(b"ne")  # type: ignore[attr-defined]
        raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        write_atomically(path, break_off)
    assert path.read_bytes() == b"old"
    assert list(tmp_path.iterdir()) == [path]


def test_what_a_killed_run_left_is_removed(store: Store, tmp_path: Path):
    stored_run(store, tmp_path)
    whole = {path for path in store.root.rglob("*") if path.is_file()}
    unfinished = store.root / ".out-123" / ".partial-456"  # a stage may have a folder of its own in the one it is given
    unfinished.mkdir(parents=True)
    (unfinished / "solid.stl").write_bytes(b"half")
    (store.root / "arrays" / ".partial-123").write_bytes(b"half")
    store.prepare()
    assert {path for path in store.root.rglob("*") if path.is_file()} == whole
    assert not (store.root / ".out-123").exists()


def test_asking_a_store_writes_nothing(tmp_path: Path):
    assert Store(tmp_path / "nowhere").result("key") is None
    assert list(tmp_path.iterdir()) == []


def test_a_hash_of_a_file_is_that_of_its_content(tmp_path: Path):
    (tmp_path / "empty").write_bytes(b"")
    assert hash_file(tmp_path / "empty").startswith("e3b0c44298fc1c149afbf4c8996fb924")
