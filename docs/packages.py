#!/usr/bin/env python3
"""Draw the packages of src/retalis and their imports.

    docs/packages.py    # writes docs/images/packages.svg

Each package is drawn one level above the highest package that it imports. Arrows that follow from others are
omitted. Imports for annotations only (``if TYPE_CHECKING:``) are ignored.
"""

import ast
from html import escape
from pathlib import Path
from typing import Dict, Iterator, List, Optional, Set, Tuple

HERE = Path(__file__).resolve().parent
SOURCE = HERE.parent / "src" / "retalis"
PICTURE = HERE / "images" / "packages.svg"

GENERATED = ("msg", "srv")
"""Packages that catkin generates beside the source."""


class Module:
    """A source file and its imports.

    Attributes:
        path: the file.
        name: dotted name below ``retalis``.
        package: dotted name of its package below ``retalis``.
        tree: its syntax tree.
        nodes: all nodes of the tree.
        imports: ``(module, name)`` of each import at run time, in functions too; name is None for whole modules.
    """

    def __init__(self, path: Path):
        self.path = path
        is_package = path.name == "__init__.py"
        parts = path.relative_to(SOURCE).with_suffix("").parts
        self.name = ".".join(parts[:-1] if is_package else parts)
        self.package = ".".join(parts[:-1])
        self.tree = ast.parse(path.read_text(encoding="utf-8"))
        self.nodes = list(ast.walk(self.tree))
        self.imports = list(self._imports())

    def _imports(self) -> Iterator[Tuple[str, Optional[str]]]:
        for node in _run_time_nodes(self.tree):
            if isinstance(node, ast.ImportFrom):
                base = node.module or ""
                if node.level:
                    folders = self.package.split(".") if self.package else []
                    kept = folders[: len(folders) - node.level + 1]
                    base = ".".join(["retalis", *kept, *([base] if base else [])])
                for alias in node.names:
                    yield base, alias.name
            elif isinstance(node, ast.Import):
                for alias in node.names:
                    yield alias.name, None

    def own_imports(self) -> Iterator[str]:
        """Yield the name of each module of the package that is imported."""
        for base, name in self.imports:
            if base != "retalis" and not base.startswith("retalis."):
                continue
            inner = base[len("retalis.") :]
            if not inner and name in GENERATED:
                continue
            whole = ".".join(part for part in (inner, name) if part)
            if whole in MODULES:
                yield whole
            elif inner in MODULES:
                yield inner


def _run_time_nodes(tree: ast.AST) -> Iterator[ast.AST]:
    """Yield the nodes of a syntax tree without blocks for type checkers."""
    todo = [tree]
    while todo:
        node = todo.pop()
        if isinstance(node, ast.If) and isinstance(node.test, ast.Name) and node.test.id == "TYPE_CHECKING":
            todo.extend(node.orelse)
            continue
        yield node
        todo.extend(ast.iter_child_nodes(node))


MODULES: Dict[str, Module] = {}
for _module in map(Module, sorted(SOURCE.rglob("*.py"))):
    MODULES[_module.name] = _module

PACKAGES = sorted(
    {module.package for module in MODULES.values() if module.package and module.path.name != "__init__.py"}
)

CROSSINGS = [
    (module, MODULES[target])
    for module in MODULES.values()
    for target in module.own_imports()
    if MODULES[target].package != module.package
]
"""Importing and imported module of each import from another package."""


def package_imports() -> Dict[str, Set[str]]:
    """Return the packages that each package imports."""
    imported: Dict[str, Set[str]] = {package: set() for package in PACKAGES}
    for module, target in CROSSINGS:
        if module.package in imported and target.package in imported:
            imported[module.package].add(target.package)
    return imported


def levels(uses: Dict[str, Set[str]]) -> Dict[str, int]:
    """Return the level of each package; 0 for packages without imports.

    Raises:
        ValueError: if packages import each other.
    """
    level: Dict[str, int] = {}
    while len(level) < len(uses):
        ready = [package for package in uses if package not in level and uses[package] <= set(level)]
        level.update(
            {package: 1 + max((level[other] for other in uses[package]), default=-1) for package in ready}
        )
        if not ready:
            raise ValueError(f"import cycle among {sorted(set(uses) - set(level))}")
    return level


def drawn(uses: Dict[str, Set[str]]) -> Dict[str, Set[str]]:
    """Return the imports that do not follow from others (the transitive reduction)."""
    level = levels(uses)
    below: Dict[str, Set[str]] = {}
    for package in sorted(uses, key=level.__getitem__):
        below[package] = uses[package].union(*(below[other] for other in uses[package]))
    return {
        package: {one for one in others if not any(one in below[other] for other in others)}
        for package, others in uses.items()
    }


WIDE, HIGH, GAP, ROW = 168, 34, 14, 58
COLUMNS = (
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
    "ros",
)
COLOURS = (
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


def picture() -> str:
    """Return the picture as SVG."""
    uses = package_imports()
    level = levels(uses)
    top = max(level.values())
    places: Dict[str, Tuple[int, int]] = {}
    bands: List[Tuple[str, int, int, int, int]] = []
    left = GAP
    for group in [*COLUMNS, *sorted({package.split(".")[0] for package in PACKAGES} - set(COLUMNS))]:
        packages = [package for package in PACKAGES if package.split(".")[0] == group]
        if not packages:
            continue
        rows: Dict[int, List[str]] = {}
        for package in packages:
            rows.setdefault(level[package], []).append(package)
        width = max(map(len, rows.values())) * (WIDE + GAP) + GAP
        for row_level, row in rows.items():
            start = left + (width - len(row) * (WIDE + GAP) + GAP) // 2
            for at, package in enumerate(row):
                places[package] = start + at * (WIDE + GAP), (top - row_level) * ROW + 2 * GAP + 16
        high, low = (
            min(places[package][1] for package in packages),
            max(places[package][1] for package in packages) + HIGH,
        )
        bands.append((group, left, high - GAP - 16, width, low - high + 2 * GAP + 16))
        left += width + 2 * GAP
    height = (top + 1) * ROW + 4 * GAP
    return "\n".join(
        [*_head(left, height), *_bands(bands), *_lines(uses, places), *_boxes(places), "</svg>", ""]
    )


def _head(width: int, height: int) -> List[str]:
    return [
        f'<svg xmlns="http://www.w3.org/2000/svg" viewBox="0 0 {width} {height}" font-family="sans-serif">',
        '<defs><marker id="to" viewBox="0 0 8 8" refX="7" refY="4" markerWidth="7" markerHeight="7" orient="auto">'
        '<path d="M0,0 L8,4 L0,8 z" fill="#667"/></marker></defs>',
        f'<rect width="{width}" height="{height}" fill="white"/>',
    ]


def _bands(bands: List[Tuple[str, int, int, int, int]]) -> Iterator[str]:
    for (group, x, y, width, high), fill in zip(bands, COLOURS):
        yield f'<rect x="{x}" y="{y}" width="{width}" height="{high}" rx="8" fill="{fill}"/>'
        yield (
            f'<text x="{x + GAP}" y="{y + 18}" font-size="13" font-weight="bold" fill="#445">{escape(group)}/</text>'
        )


def _lines(uses: Dict[str, Set[str]], places: Dict[str, Tuple[int, int]]) -> Iterator[str]:
    for package, others in sorted(drawn(uses).items()):
        for other in sorted(others):
            x, y = places[package][0] + WIDE // 2, places[package][1] + HIGH
            to_x, to_y = places[other][0] + WIDE // 2, places[other][1]
            bend = (to_y - y) // 2
            yield (
                f'<path d="M{x},{y} C{x},{y + bend} {to_x},{to_y - bend} {to_x},{to_y}" fill="none" '
                'stroke="#667" stroke-width="1.2" marker-end="url(#to)"/>'
            )


def _boxes(places: Dict[str, Tuple[int, int]]) -> Iterator[str]:
    for package, (x, y) in sorted(places.items()):
        summary = (ast.get_docstring(MODULES[package].tree) or "").partition("\n")[0]
        yield (
            f'<g><title>{escape(summary)}</title><rect x="{x}" y="{y}" width="{WIDE}" height="{HIGH}" rx="4" '
            f'fill="white" stroke="#445"/><text x="{x + WIDE // 2}" y="{y + 22}" font-size="14" text-anchor="middle">'
            f"{escape(package.rpartition('.')[2])}</text></g>"
        )


if __name__ == "__main__":
    PICTURE.write_text(picture(), encoding="utf-8")
