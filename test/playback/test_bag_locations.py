"""Locations of bags: search, download, and atomic results."""

import sys
from pathlib import Path
from typing import Any, List, Tuple

import pytest

from retalis import BagError
from retalis.playback.bag_locations import (
    BagLocation,
    find_bags,
    group_recordings,
    local_copy,
    location_exists,
    remove_incomplete_results,
    result_file,
)


@pytest.fixture
def fleet(tmp_path: Path) -> Path:
    """Return a folder with bags of two robots, including a ROS 2 bag, and with other files."""
    names = (
        "r2/day.bag",
        "r1/night.mcap",
        "r1/day.bag",
        "r1/day.truth.json",
        "r1/day.bag.active",
        "r1-notes.txt",
        "r10/ros2/metadata.yaml",
        "r10/ros2/ros2_0.db3",
        ".trash/old.bag",
        "r1/.day.bag.0123.part",
    )
    for name in names:
        path = tmp_path / "fleet" / name
        path.parent.mkdir(parents=True, exist_ok=True)
        path.write_text(name)
    return tmp_path / "fleet"


BAG_PATHS = ["r1/day.bag", "r1/night.mcap", "r10/ros2", "r2/day.bag"]
BAG_NAMES = ["r1/day", "r1/night", "r10/ros2", "r2/day"]


def test_bags_of_folder_are_sorted_by_name(fleet: Path) -> None:
    bags = find_bags(["x/z.bag", f"{fleet}/", f"{fleet}/r10/ros2", "y"])
    assert [bag.location for bag in bags] == [
        "x/z.bag",
        *(f"{fleet}/{name}" for name in BAG_PATHS),
        f"{fleet}/r10/ros2",
        "y",
    ]
    assert [bag.name for bag in bags] == ["z", *BAG_NAMES, "ros2", "y"]


def test_compressed_ros2_files_are_bags(tmp_path: Path) -> None:
    for name in ("a.db3.zstd", "b.mcap.zstd", "c.zstd", "d.bag.zstd"):
        (tmp_path / name).touch()
    assert [bag.name for bag in find_bags([str(tmp_path)])] == ["a", "b"]
    assert [bag.name for bag in find_bags(["x/e.db3.zstd", "f.zstd"])] == ["e", "f.zstd"]


def test_url_has_same_bags_as_folder(fleet: Path) -> None:
    pytest.importorskip("fsspec")
    bags = find_bags([f"file://{fleet}", f"file://{fleet}/r10/ros2", f"file://{fleet}/r2/day.bag"])
    assert [bag.location for bag in bags] == [
        *(f"file://{fleet}/{name}" for name in BAG_PATHS),
        f"file://{fleet}/r10/ros2",
        f"file://{fleet}/r2/day.bag",
    ]
    assert [bag.name for bag in bags] == [*BAG_NAMES, "ros2", "day"]


@pytest.mark.parametrize(
    ("names", "recordings"),
    [
        (("b", "a"), [["b"], ["a"]]),
        (("r_0", "r_1", "r_10", "r_2"), [["r_0", "r_1", "r_2"], ["r_10"]]),
        (("x/r_0", "y/r_1", "x/r_1"), [["x/r_0", "x/r_1"], ["y/r_1"]]),
        (
            ("r_2014-10-19-19-50-06_0", "r_2014-10-19-19-55-06_1", "r_2014-10-20-08-00-00_0"),
            [["r_2014-10-19-19-50-06_0", "r_2014-10-19-19-55-06_1"], ["r_2014-10-20-08-00-00_0"]],
        ),
        (("r_1_0", "r_1_1", "r_0_0", "r_0"), [["r_1_0", "r_1_1"], ["r_0_0"], ["r_0"]]),
        (("r_0", "q", "r_5", "r_1"), [["r_0", "r_1"], ["q"], ["r_5"]]),
        (("r", "r", "r_", "_1"), [["r"], ["r"], ["r_"], ["_1"]]),
    ],
)
def test_names_group_parts_of_recording(names: Tuple[Any, ...], recordings: List[List[str]]) -> None:
    groups = group_recordings([BagLocation(f"/d/{name}.bag", name) for name in names])
    assert [[bag.name for bag in parts] for parts in groups] == recordings


def test_folder_without_bags_is_an_error(tmp_path: Path) -> None:
    with pytest.raises(
        BagError, match="has no bags below it: no metadata.yaml, nothing that ends in .bag, .bag.active, .db3"
    ):
        find_bags([str(tmp_path)])


def test_missing_fsspec_is_named(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(sys.modules, "fsspec.core", None)
    with pytest.raises(
        BagError, match=r"s3://a/b: URLs need the Python package fsspec \(pip install fsspec, and"
    ):
        find_bags(["s3://a/b"])


def test_unknown_protocol_of_url_is_an_error() -> None:
    pytest.importorskip("fsspec")
    with pytest.raises(BagError, match="nowhere://a/b: Protocol not known: nowhere"):
        find_bags(["nowhere://a/b"])


def test_local_bag_is_not_copied(fleet: Path, tmp_path: Path) -> None:
    with local_copy(str(fleet / "r2/day.bag"), str(tmp_path)) as path:
        assert path == str(fleet / "r2/day.bag")


@pytest.mark.parametrize(("bag", "file"), [("r2/day.bag", ""), ("r10/ros2", "metadata.yaml")])
def test_downloaded_bag_is_removed_after_use(fleet: Path, tmp_path: Path, bag: str, file: str) -> None:
    pytest.importorskip("fsspec")
    scratch = tmp_path / "scratch"
    scratch.mkdir()
    with local_copy(f"file://{fleet}/{bag}", str(scratch)) as path:
        assert path.startswith(f"{scratch}/")
        assert Path(path).name == Path(bag).name
        assert Path(path, file).read_text() == str(Path(bag, file))
    assert list(scratch.iterdir()) == []


def test_download_of_missing_bag_is_an_error(fleet: Path, tmp_path: Path) -> None:
    pytest.importorskip("fsspec")
    with pytest.raises(BagError, match="none.bag: "), local_copy(f"file://{fleet}/none.bag", str(tmp_path)):
        pytest.fail("there is nothing to fetch")


@pytest.mark.parametrize("scheme", ["", "file://"])
def test_only_complete_result_is_stored(tmp_path: Path, scheme: str) -> None:
    if scheme:
        pytest.importorskip("fsspec")
    target = tmp_path / "new" / "folder" / "a.jsonl"
    with result_file(f"{scheme}{target}", str(tmp_path)) as path, open(path, "w") as file:
        file.write("all")
        assert not location_exists(f"{scheme}{target}")
    assert location_exists(f"{scheme}{target}")
    assert target.read_text() == "all"

    def write_half() -> None:
        with result_file(f"{scheme}{target}", str(tmp_path)) as path:
            Path(path).write_text("half")
            raise ZeroDivisionError

    with pytest.raises(ZeroDivisionError):
        write_half()
    assert target.read_text() == "all"
    assert [entry.name for entry in target.parent.iterdir()] == ["a.jsonl"]


@pytest.mark.parametrize(("name", "is_shared"), [("a.csv", False), ("a.parquet", False), ("a.mcap", True)])
def test_only_incomplete_bags_have_suffix_of_result(tmp_path: Path, name: str, is_shared: bool) -> None:
    """Data tools read all files with a suffix, hidden ones too; the suffix of a bag selects its format."""
    with result_file(f"{tmp_path}/{name}", str(tmp_path)) as path:
        Path(path).write_text("half")
        assert (Path(path).suffix == Path(name).suffix) == is_shared


def test_unwritable_result_is_an_error(tmp_path: Path) -> None:
    (tmp_path / "file").touch()
    result = result_file(str(tmp_path / "file" / "a.bag"), str(tmp_path))
    with pytest.raises(BagError, match="file/a.bag cannot be written: "), result:
        pytest.fail("there is nowhere to write")


def test_incomplete_results_are_removed(tmp_path: Path) -> None:
    other_names = [".02.incomplete.b.bag", ".incomplete", "03.incomplete.a.bag", "a.bag"]
    incomplete_names = [
        ".01.incomplete.a.bag",
        ".05.incomplete..04.incomplete.a.bag",
        ".06.incomplete.a.csv.part",
    ]
    for name in (*other_names, *incomplete_names):
        (tmp_path / name).touch()
    remove_incomplete_results(
        [f"{tmp_path}/a.bag", f"{tmp_path}/a.csv", "s3://bucket/b.bag", f"{tmp_path}/none/c.bag"]
    )
    assert sorted(path.name for path in tmp_path.iterdir()) == sorted(other_names)


def test_result_creates_no_bucket(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    memory = pytest.importorskip("fsspec.implementations.memory").MemoryFileSystem
    calls: List[str] = []
    monkeypatch.setattr(memory, "makedirs", lambda self, path, exist_ok: calls.append(f"makedirs {path}"))
    monkeypatch.setattr(memory, "put_file", lambda self, source, path: calls.append(f"put_file {path}"))
    for protocol in ("memory", ("s3", "s3a")):
        monkeypatch.setattr(memory, "protocol", protocol)
        with result_file("memory://fleet/results/a.csv", str(tmp_path)) as path:
            Path(path).write_text("a")
    stored = "put_file /fleet/results/a.csv"
    assert calls == ["makedirs /fleet/results", stored, stored]


def test_download_beyond_stated_size_is_an_error(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    memory = pytest.importorskip("fsspec.implementations.memory").MemoryFileSystem
    with memory().open("/sent.bag", "wb") as file:
        file.write(bytes(9_000_000))
    with local_copy("memory://sent.bag", str(tmp_path)) as path:
        assert Path(path).stat().st_size == 9_000_000
    monkeypatch.setattr(memory, "size", lambda self, path: 1000)
    with pytest.raises(
        BagError, match=r"memory://sent\.bag: .* has more than 1000 bytes, as stated or as half of"
    ), local_copy("memory://sent.bag", str(tmp_path)):
        pass
    assert list(tmp_path.iterdir()) == []
    memory().rm("/sent.bag")


def test_write_ahead_log_is_downloaded_with_its_file(tmp_path: Path) -> None:
    pytest.importorskip("fsspec")
    for name in ("a.db3", "a.db3-wal", "b.db3"):
        (tmp_path / name).write_text(name)
    scratch = tmp_path / "scratch"
    scratch.mkdir()
    with local_copy(f"file://{tmp_path}/a.db3", str(scratch)) as path:
        assert Path(f"{path}-wal").read_text() == "a.db3-wal"
    with local_copy(f"file://{tmp_path}/b.db3", str(scratch)) as path:
        assert [file.name for file in Path(path).parent.iterdir()] == ["b.db3"]
