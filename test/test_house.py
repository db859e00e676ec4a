"""The house: rooms import downwards only, and of each other only what a room hands on."""

import ast
import re
from functools import lru_cache

import pytest
from source import ROOT, house

MODULES, ROOMS, WINGS, CROSSINGS = house.MODULES, house.ROOMS, house.WINGS, house.CROSSINGS

ORDER = (
    "foundation",
    "prolog.terms",
    "prolog.syntax",
    "prolog.machine",
    "prolog.arithmetic",
    "prolog.compiler",
    "prolog.database",
    "prolog.builtins",
    "prolog.logic",
    "prolog.foreign",
    "prolog.swi",
    "messages",
    "events.streams",
    "events.language",
    "events.dispatch",
    "events.matches",
    "events.fused",
    "events.history",
    "events.network",
    "events.program",
    "events.rules",
    "events.knowledge",
    "events.checks",
    "engine.runtime",
    "engine.keeping",
    "engine",
    "engine.explaining",
    "engine.drawing",
    "engine.dashboard",
    "engine.playback",
    "cli",
    "ros",
)
"""The rooms from the ground up: each imports only rooms before it."""

MOST_NAMES = 10
"""Names that `src/retalis` shows, folders and files alike; `__init__.py`, `__main__.py` and `py.typed` are three."""

STARTED = {"cli": {"import_commands", "main"}}
"""What is used by nobody but those who start a program: in `__main__.py`."""

USERS = (
    *sorted((ROOT / "examples").rglob("*.py")),
    *sorted((ROOT / "docs").glob("*.md")),
    ROOT / "README.md",
)
"""Programs and pages whose names are the user's."""

TESTED_ELSEWHERE = ("bench", "examples", "oracle", "fuzz", "interrupts", "faults", "mutation")
"""Folders of tests that are no rooms: of other folders, and programs that look for errors."""

ROS = {"genpy", "rosgraph", "rosgraph_msgs", "roslib", "rospy", "rostopic", "std_msgs"}


def test_rooms_are_those_of_the_order():
    assert sorted(ORDER) == ROOMS


def test_package_shows_few_names():
    kept = [path for path in house.SOURCE.rglob("*") if path.is_file() and "__pycache__" not in path.parts]
    names = {path.relative_to(house.SOURCE).parts[0] for path in kept} | {"py.typed"}
    assert len(names) <= MOST_NAMES, sorted(names)


def test_no_file_is_marked_as_private():
    """Its room's `__init__.py` says already what is for others."""
    assert [module.path for module in MODULES.values() if re.match(r"_[^_]", module.path.name)] == []


@pytest.mark.parametrize("room", ORDER)
def test_only_what_a_room_hands_on_is_imported(room):
    wrong = []
    for module, target, name in CROSSINGS:
        if module.room != room:
            continue
        if target not in ORDER:  # a module, or a wing: a room may hand on the whole of a module
            face = MODULES.get(target.rpartition(".")[0])
            if name is not None or face is None or target.rpartition(".")[2] not in face.handed_on():
                wrong.append(f"{module.path}: {name or 'all'} of {target or 'the package'}")
        elif name is not None and name not in MODULES[target].handed_on():
            wrong.append(f"{module.path}: {name}, which {target} does not hand on")
    assert not wrong, "\n".join(wrong)


@pytest.mark.parametrize("room", ORDER)
def test_imports_run_downwards(room):
    below = ORDER[: ORDER.index(room)]
    upwards = [
        f"{module.path}: {target or 'the package'}"
        for module, target, _ in CROSSINGS
        if module.room == room and room_of(target) not in below
    ]
    assert not upwards, "\n".join(upwards)


def test_no_file_reaches_itself():
    """Imports that only type checkers see, and those inside functions, count as all others do."""
    files = [module for module in MODULES.values() if not module.is_face]
    arrows = {module.name: set() for module in files}
    for module in files:
        for target, name in module.own_imports():
            arrows[module.name].add(home(target, name))
    arrows = {name: {other for other in others if other in arrows} for name, others in arrows.items()}
    while True:
        sound = {name for name, others in arrows.items() if not others}
        if not sound:
            break
        arrows = {name: others - sound for name, others in arrows.items() if name not in sound}
    assert not arrows


def test_only_the_nodes_know_ros():
    knowing = {
        module.room for module in MODULES.values() for base, _ in module.imports if base.split(".")[0] in ROS
    }
    assert knowing == {"ros"}


def test_one_module_compiles_and_none_builds_syntax_trees():
    """CPython fails where two threads build syntax trees at once, and every connection of a node has a thread."""
    compiling = {
        module.name
        for module in MODULES.values()
        for node in module.nodes
        if isinstance(node, ast.Name) and node.id in ("compile", "exec", "eval")
    }
    assert compiling == {"foundation.codegen"}
    assert not [module.name for module in MODULES.values() for base, _ in module.imports if base == "ast"]


@pytest.mark.parametrize("wing", WINGS)
def test_a_wing_hands_nothing_on(wing):
    body = MODULES[wing].tree.body
    assert len(body) == 1
    assert isinstance(body[0], ast.Expr)


@pytest.mark.parametrize("room", [room for room in ORDER if room != "ros"])
def test_what_is_handed_on_is_used(room):
    """ROS's own room has no names for others: its modules are started."""
    tree = MODULES[room].tree
    handed_on = set(MODULES[room].handed_on()) | STARTED.get(room, set())
    assert handed_on
    modules = {module.name.rpartition(".")[2] for module in MODULES.values() if module.room == room}
    assert handed_on <= {name for node in tree.body for name in bound_by(node)} | modules
    used = set()
    for module, target, name in CROSSINGS:
        if target == room and name is None:  # all of it: what is used are its attributes
            used |= attributes(module, room.rpartition(".")[2])
        elif room_of(target) == room:
            used.add(name or target.rpartition(".")[2])
    assert not handed_on - used - words_of_users()


def test_tests_stand_where_what_they_test_stands():
    wrong = []
    for path in sorted((ROOT / "test").rglob("test_*.py")):
        folder, name = path.parent.relative_to(ROOT / "test"), path.name[len("test_") :]
        if folder.as_posix() in TESTED_ELSEWHERE:
            continue
        room = house.SOURCE / folder
        if not room.is_dir() or (not (room / name).exists() and list(room.glob(f"*/**/{name}"))):
            wrong.append(path.relative_to(ROOT).as_posix())
    assert wrong == []


def test_picture_is_that_of_the_imports():
    assert house.PICTURE.read_text(encoding="utf-8") == house.picture(), "run docs/house.py"


@lru_cache(maxsize=None)
def words_of_users():
    return {word for path in USERS for word in re.findall(r"\w+", path.read_text(encoding="utf-8"))}


def room_of(target):
    return target if target in ORDER else MODULES[target].room


def home(target, name):
    """Return the module that defines a name which rooms hand on."""
    if name is not None and MODULES[target].is_face:
        for other, known in MODULES[target].own_imports():
            if known == name and other != target:
                return home(other, name)
    return target


def bound_by(node):
    """Yield the names that a statement at the top of a module binds."""
    if isinstance(node, (ast.Import, ast.ImportFrom)):
        for alias in node.names:
            yield alias.asname or alias.name
    elif isinstance(node, (ast.FunctionDef, ast.ClassDef)):
        yield node.name


def attributes(module, name):
    """Return the attributes of a name that a module looks at."""
    return {
        node.attr
        for node in module.nodes
        if isinstance(node, ast.Attribute) and isinstance(node.value, ast.Name) and node.value.id == name
    }
