#!/usr/bin/env python3
"""Draw the packages of src/retalis and their imports.

    docs/packages.py    # writes docs/images/packages.svg

Each package is drawn one level above the highest package that it imports. Arrows that follow from others are
omitted. Imports for annotations only (``if TYPE_CHECKING:``) are ignored.
"""

import ast
from functools import cached_property, lru_cache
from html import escape
from pathlib import Path
from typing import Dict, Iterable, Iterator, List, NamedTuple, Optional, Set, Tuple

HERE = Path(__file__).resolve().parent
SOURCE = HERE.parent / "src" / "retalis"
PICTURE = HERE / "images" / "packages.svg"

GENERATED = ("msg", "srv")
"""Packages that catkin generates beside the source."""


class Module:
    """A source file and its imports. It is parsed when it is needed, because tests need a few of all files.

    Attributes:
        path: the file.
        name: dotted name below ``retalis``.
        package: dotted name of its package below ``retalis``.
    """

    def __init__(self, path: Path):
        self.path = path
        is_package = path.name == "__init__.py"
        parts = path.relative_to(SOURCE).with_suffix("").parts
        self.name = ".".join(parts[:-1] if is_package else parts)
        self.package = ".".join(parts[:-1])

    @cached_property
    def tree(self) -> ast.Module:
        """The syntax tree."""
        return ast.parse(self.path.read_text(encoding="utf-8"))

    @cached_property
    def nodes(self) -> List[ast.AST]:
        """All nodes of the tree."""
        return list(ast.walk(self.tree))

    @cached_property
    def _nodes_at_run_time(self) -> List[ast.AST]:
        return list(_nodes_at_run_time(self.tree))

    @cached_property
    def imports(self) -> List[Tuple[str, Optional[str]]]:
        """``(module, name)`` of each import at run time, in functions too; name is None for whole modules."""
        return list(self._imports(self._nodes_at_run_time))

    @cached_property
    def annotation_imports(self) -> List[Tuple[str, Optional[str]]]:
        """The same for imports that only annotations use (``if TYPE_CHECKING:``)."""
        return list(self._imports(set(self.nodes).difference(self._nodes_at_run_time)))

    def _imports(self, nodes: Iterable[ast.AST]) -> Iterator[Tuple[str, Optional[str]]]:
        for node in nodes:
            if isinstance(node, ast.ImportFrom):
                base = node.module or ""
                if node.level:
                    folders = self.package.split(".") if self.package else []
                    parents = folders[: len(folders) - node.level + 1]
                    base = ".".join(["retalis", *parents, *([base] if base else [])])
                for alias in node.names:
                    yield base, alias.name
            elif isinstance(node, ast.Import):
                for alias in node.names:
                    yield alias.name, None

    def own_imports(self, for_annotations: bool = False) -> Iterator[str]:
        """Yield the name of each module of ``retalis`` that is imported, at run time or for annotations only."""
        for base, name in self.annotation_imports if for_annotations else self.imports:
            if base != "retalis" and not base.startswith("retalis."):
                continue
            module = base[len("retalis.") :]
            if not module and name in GENERATED:
                continue
            # ``from .package import name`` imports a module or a name of the module ``package``.
            submodule = ".".join(part for part in (module, name) if part)
            if submodule in MODULES:
                yield submodule
            elif module in MODULES:
                yield module


def _nodes_at_run_time(tree: ast.AST) -> Iterator[ast.AST]:
    """Yield the nodes of a syntax tree, except those of blocks for type checkers."""
    unvisited = [tree]
    while unvisited:
        node = unvisited.pop()
        if isinstance(node, ast.If) and isinstance(node.test, ast.Name) and node.test.id == "TYPE_CHECKING":
            unvisited.extend(node.orelse)
            continue
        yield node
        unvisited.extend(ast.iter_child_nodes(node))


MODULES: Dict[str, Module] = {}
for _module in map(Module, sorted(SOURCE.rglob("*.py"))):
    MODULES[_module.name] = _module

PACKAGES = sorted(
    {module.package for module in MODULES.values() if module.package and module.path.name != "__init__.py"}
)


@lru_cache(maxsize=1)
def cross_package_imports() -> List[Tuple[Module, Module]]:
    """Return the importing and the imported module of each import from another package."""
    return [
        (module, MODULES[target])
        for module in MODULES.values()
        for target in module.own_imports()
        if MODULES[target].package != module.package
    ]


def package_imports() -> Dict[str, Set[str]]:
    """Return the packages that each package imports."""
    imported: Dict[str, Set[str]] = {package: set() for package in PACKAGES}
    for module, target in cross_package_imports():
        if module.package in imported and target.package in imported:
            imported[module.package].add(target.package)
    return imported


def package_levels(imports: Dict[str, Set[str]]) -> Dict[str, int]:
    """Return the level of each package; 0 for packages without imports.

    Raises:
        ValueError: if packages import each other.
    """
    levels: Dict[str, int] = {}
    while len(levels) < len(imports):
        ready = [package for package in imports if package not in levels and imports[package] <= set(levels)]
        levels.update(
            {
                package: 1 + max((levels[imported] for imported in imports[package]), default=-1)
                for package in ready
            }
        )
        if not ready:
            raise ValueError(f"import cycle among {sorted(set(imports) - set(levels))}")
    return levels


def transitive_reduction(imports: Dict[str, Set[str]]) -> Dict[str, Set[str]]:
    """Return the imports that do not follow from others."""
    levels = package_levels(imports)
    reachable: Dict[str, Set[str]] = {}
    for package in sorted(imports, key=levels.__getitem__):
        reachable[package] = imports[package].union(*(reachable[imported] for imported in imports[package]))
    return {
        package: {
            candidate
            for candidate in imported
            if not any(candidate in reachable[other] for other in imported)
        }
        for package, imported in imports.items()
    }


BOX_WIDTH, BOX_HEIGHT, GAP, LEVEL_HEIGHT = 168, 34, 14, 58
"""Sizes in units of the picture."""

TOP_PACKAGES = (
    "foundation",
    "prolog",
    "messages",
    "events",
    "serialization",
    "engine",
    "explanation",
    "visualization",
    "dashboard",
    "playback",
    "cli",
    "node",
    "ros1",
    "ros2",
)
"""Packages directly below ``retalis``, from left to right."""

BAND_COLOURS = (
    "#e8e4da",
    "#dfe9f3",
    "#e6f0df",
    "#f7ead8",
    "#f3dfe3",
    "#e9e2f3",
    "#dcefee",
    "#efe3d3",
    "#e3eef7",
    "#f0e6ef",
    "#e8f0dc",
    "#e4e4ee",
)


class Band(NamedTuple):
    """Rectangle behind the boxes of a top package and of the packages in it."""

    package: str
    x: int
    y: int
    width: int
    height: int


def picture() -> str:
    """Return the picture as SVG."""
    imports = package_imports()
    levels = package_levels(imports)
    top_level = max(levels.values())
    positions: Dict[str, Tuple[int, int]] = {}
    bands: List[Band] = []
    left = GAP
    other_packages = {package.split(".")[0] for package in PACKAGES} - set(TOP_PACKAGES)
    for top_package in [*TOP_PACKAGES, *sorted(other_packages)]:
        packages = [package for package in PACKAGES if package.split(".")[0] == top_package]
        if not packages:
            continue
        rows: Dict[int, List[str]] = {}
        for package in packages:
            rows.setdefault(levels[package], []).append(package)
        width = max(map(len, rows.values())) * (BOX_WIDTH + GAP) + GAP
        for level, row in rows.items():
            start = left + (width - len(row) * (BOX_WIDTH + GAP) + GAP) // 2
            y = (top_level - level) * LEVEL_HEIGHT + 2 * GAP + 16
            for column, package in enumerate(row):
                positions[package] = start + column * (BOX_WIDTH + GAP), y
        top = min(positions[package][1] for package in packages)
        bottom = max(positions[package][1] for package in packages) + BOX_HEIGHT
        bands.append(Band(top_package, left, top - GAP - 16, width, bottom - top + 2 * GAP + 16))
        left += width + 2 * GAP
    height = (top_level + 1) * LEVEL_HEIGHT + 4 * GAP
    return "\n".join(
        [*_head(left, height), *_bands(bands), *_arrows(imports, positions), *_boxes(positions), "</svg>", ""]
    )


def _head(width: int, height: int) -> List[str]:
    return [
        f'<svg xmlns="http://www.w3.org/2000/svg" viewBox="0 0 {width} {height}" font-family="sans-serif">',
        '<defs><marker id="to" viewBox="0 0 8 8" refX="7" refY="4" markerWidth="7" markerHeight="7" orient="auto">'
        '<path d="M0,0 L8,4 L0,8 z" fill="#667"/></marker></defs>',
        f'<rect width="{width}" height="{height}" fill="white"/>',
    ]


def _bands(bands: List[Band]) -> Iterator[str]:
    for band, fill in zip(bands, BAND_COLOURS):
        yield (
            f'<rect x="{band.x}" y="{band.y}" width="{band.width}" height="{band.height}" rx="8" fill="{fill}"/>'
        )
        yield (
            f'<text x="{band.x + GAP}" y="{band.y + 18}" font-size="13" font-weight="bold" fill="#445">'
            f"{escape(band.package)}/</text>"
        )


def _arrows(imports: Dict[str, Set[str]], positions: Dict[str, Tuple[int, int]]) -> Iterator[str]:
    for package, reduced in sorted(transitive_reduction(imports).items()):
        for imported in sorted(reduced):
            x, y = positions[package][0] + BOX_WIDTH // 2, positions[package][1] + BOX_HEIGHT
            to_x, to_y = positions[imported][0] + BOX_WIDTH // 2, positions[imported][1]
            bend = (to_y - y) // 2
            yield (
                f'<path d="M{x},{y} C{x},{y + bend} {to_x},{to_y - bend} {to_x},{to_y}" fill="none" '
                'stroke="#667" stroke-width="1.2" marker-end="url(#to)"/>'
            )


def _boxes(positions: Dict[str, Tuple[int, int]]) -> Iterator[str]:
    for package, (x, y) in sorted(positions.items()):
        summary = (ast.get_docstring(MODULES[package].tree) or "").partition("\n")[0]
        yield (
            f'<g><title>{escape(summary)}</title><rect x="{x}" y="{y}" width="{BOX_WIDTH}" height="{BOX_HEIGHT}" '
            f'rx="4" fill="white" stroke="#445"/><text x="{x + BOX_WIDTH // 2}" y="{y + 22}" font-size="14" '
            f'text-anchor="middle">{escape(package.rpartition(".")[2])}</text></g>'
        )


if __name__ == "__main__":
    PICTURE.write_text(picture(), encoding="utf-8")
