"""Structure of the package: imports go one way, between packages and between modules."""

import ast
import re
from collections import Counter
from pathlib import Path
from typing import Any, Iterator, List

import pytest
from parsed_sources import ROOT, packages

MODULES = packages.MODULES

ORDER = (
    "foundation",
    "prolog.terms",
    "serialization",
    "prolog.syntax",
    "prolog.machine",
    "prolog.compiler",
    "prolog.database",
    "prolog.files",
    "prolog.builtins",
    "prolog.system",
    "prolog.swi",
    "messages",
    "events.clock",
    "events.streams",
    "events.language",
    "events.dispatch",
    "events.matches",
    "events.fused",
    "events.network",
    "events.provenance",
    "events.rules",
    "events.program",
    "events.knowledge",
    "events.checks",
    "engine.runtime",
    "engine",
    "explanation",
    "editing",
    "visualization",
    "dashboard",
    "forwarding",
    "fleet",
    "node",
    "playback",
    "testing",
    "cli",
    "ros1",
    "ros2",
)
"""The packages from the lowest to the highest: each imports only packages before it."""

REPEATED_NAMES = {"errors", "types", "parser", "protocols", "__init__"}
"""Names that modules of several packages may have."""

MAX_LINES = 1_000

ROS = {"genpy", "rosgraph", "rosgraph_msgs", "roslib", "rospy", "rostopic", "std_msgs"}

TESTED_ELSEWHERE = ("bench", "examples", "oracle", "fuzz", "leaks", "faults", "mutation")
"""Folders of tests without a package of their own."""


def test_order_has_all_packages() -> None:
    assert sorted(ORDER) == packages.PACKAGES


@pytest.mark.parametrize("package", ORDER)
def test_packages_import_lower_packages_only(package: str) -> None:
    below = ORDER[: ORDER.index(package)]
    upward_imports = [
        f"{module.path}: {target.name}"
        for module, target in packages.cross_package_imports()
        if module.package == package and target.name and target.package not in below
    ]
    assert not upward_imports, "\n".join(upward_imports)


@pytest.mark.parametrize("package", ORDER)
def test_annotations_name_no_package_above(package: str) -> None:
    below = ORDER[: ORDER.index(package)]
    upward_imports = [
        f"{module.name}: {target}"
        for module in MODULES.values()
        if module.package == package
        for target in module.own_imports(for_annotations=True)
        if MODULES[target].package not in (package, *below)
    ]
    assert not upward_imports, "\n".join(upward_imports)


def test_imports_of_modules_have_no_cycle() -> None:
    imported = {module.name: set(module.own_imports()) - {module.name} for module in MODULES.values()}
    while True:
        free = {name for name, others in imported.items() if not others}
        if not free:
            break
        imported = {name: others - free for name, others in imported.items() if name not in free}
    assert not imported


def test_packages_are_two_levels_deep_at_most() -> None:
    assert [name for name in packages.PACKAGES if name.count(".") > 1] == []


def test_module_names_are_unique() -> None:
    names = Counter(module.path.stem for module in MODULES.values())
    assert [name for name, count in names.items() if count > 1 and name not in REPEATED_NAMES] == []


def test_no_module_is_too_long() -> None:
    lengths = {
        name: len(module.path.read_text(encoding="utf-8").splitlines()) for name, module in MODULES.items()
    }
    assert {name: length for name, length in lengths.items() if length > MAX_LINES} == {}


def test_init_files_contain_docstring_only() -> None:
    other_modules = [
        module.name
        for module in MODULES.values()
        if module.path.name == "__init__.py" and module.name and len(module.tree.body) != 1
    ]
    assert other_modules == []


def test_private_names_are_not_imported() -> None:
    private_imports = [
        f"{module.path}: {name}"
        for module in MODULES.values()
        for base, name in module.imports
        if base.startswith("retalis") and name is not None and name.startswith("_")
    ]
    assert private_imports == []


def test_only_the_nodes_import_ros() -> None:
    importing = {
        module.package
        for module in MODULES.values()
        for base, _ in module.imports
        if base.split(".")[0] in ROS
    }
    assert importing == {"ros1"}


def test_only_package_ros2_imports_rclpy() -> None:
    importing = {
        module.package
        for module in MODULES.values()
        for base, _ in module.imports
        if base.split(".")[0] == "rclpy"
    }
    assert importing == {"ros2"}


def test_only_one_module_imports_flink() -> None:
    """The other modules of the fleet run where Flink is not installed."""
    importing = {
        module.name
        for module in MODULES.values()
        for base, _ in module.imports
        if base.split(".")[0] == "pyflink"
    }
    assert importing == {"fleet.flink_job"}


def test_one_module_compiles_source() -> None:
    """No module builds syntax trees: CPython fails if two threads do, and each connection of a node has a thread."""
    compiling = {
        module.name
        for module in MODULES.values()
        for node in module.nodes
        if isinstance(node, ast.Name) and node.id in ("compile", "exec", "eval")
    }
    assert compiling == {"foundation.codegen"}
    assert not [module.name for module in MODULES.values() for base, _ in module.imports if base == "ast"]


def test_tests_mirror_packages() -> None:
    misplaced: List[Any] = []
    for path in sorted((ROOT / "test").rglob("test_*.py")):
        folder, name = path.parent.relative_to(ROOT / "test"), path.name[len("test_") :]
        if folder.as_posix() in TESTED_ELSEWHERE:
            continue
        package = packages.SOURCE / folder
        if not package.is_dir() or (not (package / name).exists() and list(package.glob(f"*/**/{name}"))):
            misplaced.append(path.relative_to(ROOT).as_posix())
    assert misplaced == []


def test_picture_shows_imports() -> None:
    assert packages.PICTURE.read_text(encoding="utf-8") == packages.picture(), "run docs/packages.py"


def imports_of_scripts() -> Iterator[Any]:
    """Yield the imports of the package by files outside it: file, module and name."""
    scripts = [
        path for folder in ("bench", "docs", "examples", "nodes") for path in (ROOT / folder).rglob("*")
    ]
    for path in [*scripts, *ROOT.glob("*.py")]:
        if path.is_file() and "_build" not in path.parts and is_python(path):
            for node in ast.walk(ast.parse(path.read_text(encoding="utf-8"))):
                if isinstance(node, ast.ImportFrom) and (node.module or "").startswith("retalis"):
                    for alias in node.names:
                        yield path.relative_to(ROOT).as_posix(), node.module, alias.name


def is_python(path: Path) -> Any:
    """Return whether a file is a Python script."""
    if path.suffix:
        return path.suffix == ".py"
    return path.read_bytes().startswith(b"#!/usr/bin/env python")


SCRIPT_IMPORTS = sorted(set(imports_of_scripts()))


def test_programs_of_nodes_have_unique_names() -> None:
    """Programs of one name in two folders make rosrun ask which one is meant, or roslaunch refuse the node."""
    names = Counter(path.name for path in (ROOT / "nodes").rglob("*") if path.is_file())
    assert [name for name, count in names.items() if count > 1] == []


def test_imports_of_nodes_are_checked() -> None:
    assert {path for path, _, _ in SCRIPT_IMPORTS} >= {
        f"nodes/{name}" for name in ("retalis", "retalis_node")
    }


@pytest.mark.parametrize(("path", "module", "name"), SCRIPT_IMPORTS)
def test_names_imported_by_scripts_exist(path: Any, module: Any, name: Any) -> None:
    folder = ROOT / "src" / module.replace(".", "/")
    source = folder / "__init__.py" if folder.is_dir() else folder.with_suffix(".py")
    is_submodule = (folder / name).is_dir() or (folder / f"{name}.py").is_file()
    assert is_submodule or re.search(rf"\b{name}\b", source.read_text(encoding="utf-8"))
