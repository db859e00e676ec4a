#!/usr/bin/env python3
"""Draw the house: the rooms of src/retalis and who imports whom, as the imports of the code say.

    docs/house.py    # writes docs/house.svg

A room is a folder with modules; a wing is a folder of rooms. A room stands one floor above the highest that it
imports. An arrow that follows from others is left out: who imports a room may import all that this one stands on.
"""

import ast
from html import escape
from pathlib import Path
from typing import Dict, Iterator, List, Optional, Set, Tuple

HERE = Path(__file__).resolve().parent
SOURCE = HERE.parent / "src" / "retalis"
PICTURE = HERE / "house.svg"

GENERATED = ("msg", "srv")
"""Packages that catkin puts beside ours."""


class Module:
    """A file of the package, with what it imports.

    Attributes:
        name: without the package's own.
        room: the folder in which it stands, with dots.
        is_face: whether it is an ``__init__.py``.
        nodes: those of its syntax tree.
        imports: for each import, here or in a function, the full name of a module and the name taken of it.
    """

    def __init__(self, path: Path):
        self.path = path
        self.is_face = path.name == "__init__.py"
        parts = path.relative_to(SOURCE).with_suffix("").parts
        self.name = ".".join(parts[:-1] if self.is_face else parts)
        self.room = ".".join(parts[:-1])
        self.tree = ast.parse(path.read_text(encoding="utf-8"))
        self.nodes = list(ast.walk(self.tree))
        self.imports = list(self._imports())

    def _imports(self) -> Iterator[Tuple[str, Optional[str]]]:
        for node in self.nodes:
            if isinstance(node, ast.ImportFrom):
                base = node.module or ""
                if node.level:
                    folders = self.room.split(".") if self.room else []
                    kept = folders[: len(folders) - node.level + 1]
                    base = ".".join(["retalis", *kept, *([base] if base else [])])
                for alias in node.names:
                    yield base, alias.name
            elif isinstance(node, ast.Import):
                for alias in node.names:
                    yield alias.name, None

    def own_imports(self) -> Iterator[Tuple[str, Optional[str]]]:
        """Yield what is imported of the package: a module or room, and the name taken of it; None for all of it."""
        for base, name in self.imports:
            if base != "retalis" and not base.startswith("retalis."):
                continue
            inner = base[len("retalis.") :]
            if not inner and name in GENERATED:
                continue
            whole = ".".join(part for part in (inner, name) if part)
            if whole in MODULES:
                yield whole, None
            elif inner in MODULES:
                yield inner, name

    def handed_on(self) -> List[str]:
        """Return the names in ``__all__``."""
        for node in self.tree.body:
            if isinstance(node, ast.Assign) and getattr(node.targets[0], "id", "") == "__all__":
                return list(ast.literal_eval(node.value))
        return []


MODULES: Dict[str, Module] = {}
for _module in map(Module, sorted(SOURCE.rglob("*.py"))):
    MODULES[_module.name] = _module

ROOMS = sorted({module.room for module in MODULES.values() if module.room and not module.is_face})
WINGS = sorted({room.rpartition(".")[0] for room in ROOMS if "." in room} - set(ROOMS))

CROSSINGS = [
    (module, target, name)
    for module in MODULES.values()
    for target, name in module.own_imports()
    if MODULES[target].room != module.room
]
"""Importer, module or room, and name of each import from another room."""


def arrows() -> Dict[str, Set[str]]:
    """Return for each room those that it imports."""
    found: Dict[str, Set[str]] = {room: set() for room in ROOMS}
    for module, target, _ in CROSSINGS:
        if module.room in found and MODULES[target].room in found:
            found[module.room].add(MODULES[target].room)
    return found


def floors(uses: Dict[str, Set[str]]) -> Dict[str, int]:
    """Return on which floor each room stands, the ground being 0; there must be no circle."""
    found: Dict[str, int] = {}
    while len(found) < len(uses):
        ready = [room for room in uses if room not in found and uses[room] <= set(found)]
        found.update({room: 1 + max((found[other] for other in uses[room]), default=-1) for room in ready})
        if not ready:
            raise ValueError(f"a circle among {sorted(set(uses) - set(found))}")
    return found


def drawn(uses: Dict[str, Set[str]]) -> Dict[str, Set[str]]:
    """Return the arrows that do not follow from others."""
    level = floors(uses)
    below: Dict[str, Set[str]] = {}
    for room in sorted(uses, key=level.__getitem__):
        below[room] = uses[room].union(*(below[other] for other in uses[room]))
    return {
        room: {one for one in others if not any(one in below[other] for other in others)}
        for room, others in uses.items()
    }


WIDE, HIGH, GAP, ROW = 168, 34, 14, 58
COLUMNS = ("foundation", "prolog", "messages", "events", "engine", "cli", "ros")
COLOURS = ("#e8e4da", "#dfe9f3", "#e6f0df", "#f7ead8", "#f3dfe3", "#e9e2f3", "#dcefee")


def picture() -> str:
    """Return the house as SVG."""
    uses = arrows()
    level = floors(uses)
    top = max(level.values())
    places: Dict[str, Tuple[int, int]] = {}
    bands: List[Tuple[str, int, int, int, int]] = []
    left = GAP
    for wing in [*COLUMNS, *sorted({room.split(".")[0] for room in ROOMS} - set(COLUMNS))]:
        rooms = [room for room in ROOMS if room.split(".")[0] == wing]
        if not rooms:
            continue
        rows: Dict[int, List[str]] = {}
        for room in rooms:
            rows.setdefault(level[room], []).append(room)
        width = max(map(len, rows.values())) * (WIDE + GAP) + GAP
        for floor, row in rows.items():
            start = left + (width - len(row) * (WIDE + GAP) + GAP) // 2
            for at, room in enumerate(row):
                places[room] = start + at * (WIDE + GAP), (top - floor) * ROW + 2 * GAP + 16
        high, low = min(places[room][1] for room in rooms), max(places[room][1] for room in rooms) + HIGH
        bands.append((wing, left, high - GAP - 16, width, low - high + 2 * GAP + 16))
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
    for (wing, x, y, width, high), colour in zip(bands, COLOURS):
        yield f'<rect x="{x}" y="{y}" width="{width}" height="{high}" rx="8" fill="{colour}"/>'
        yield f'<text x="{x + GAP}" y="{y + 18}" font-size="13" font-weight="bold" fill="#445">{escape(wing)}/</text>'


def _lines(uses: Dict[str, Set[str]], places: Dict[str, Tuple[int, int]]) -> Iterator[str]:
    for room, others in sorted(drawn(uses).items()):
        for other in sorted(others):
            x, y = places[room][0] + WIDE // 2, places[room][1] + HIGH
            to_x, to_y = places[other][0] + WIDE // 2, places[other][1]
            bend = (to_y - y) // 2
            yield (
                f'<path d="M{x},{y} C{x},{y + bend} {to_x},{to_y - bend} {to_x},{to_y}" fill="none" '
                'stroke="#667" stroke-width="1.2" marker-end="url(#to)"/>'
            )


def _boxes(places: Dict[str, Tuple[int, int]]) -> Iterator[str]:
    for room, (x, y) in sorted(places.items()):
        job = (ast.get_docstring(MODULES[room].tree) or "").partition("\n")[0]
        yield (
            f'<g><title>{escape(job)}</title><rect x="{x}" y="{y}" width="{WIDE}" height="{HIGH}" rx="4" '
            f'fill="white" stroke="#445"/><text x="{x + WIDE // 2}" y="{y + 22}" font-size="14" text-anchor="middle">'
            f"{escape(room.rpartition('.')[2])}</text></g>"
        )


if __name__ == "__main__":
    PICTURE.write_text(picture(), encoding="utf-8")
