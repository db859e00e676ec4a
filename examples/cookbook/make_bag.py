#!/usr/bin/env python3
"""Write the bag of a recipe from the messages that its ``messages.py`` describes.

    examples/cookbook/make_bag.py examples/cookbook/debounce    # writes debounce.bag into that folder

``messages.py`` has ``TOPICS``, the type of each topic, and ``messages()``, which yields for each message its time in
seconds, its topic and its slots by name. Slots that are not named are zero, empty or false; a header gets the time
of its message. Times count from the beginning of the bag. The same recipe gives the same bag.
"""

import argparse
import sys
from importlib.util import module_from_spec, spec_from_file_location
from pathlib import Path
from typing import Any, Dict, Iterator, List, NamedTuple, Optional

_SOURCE = Path(__file__).resolve().parents[2] / "src"
if _SOURCE.is_dir() and str(_SOURCE) not in sys.path:
    sys.path.append(str(_SOURCE))

from retalis import BagWriter, Definition, Definitions, RetalisError, Term, atom, functor, make_list  # noqa: E402

START = 1_700_000_000
"""Start of the bags in seconds since the epoch."""

SECOND = 10**9


class Message(NamedTuple):
    """One message of a recipe: time in nanoseconds since the epoch, topic, and slots by name."""

    time: int
    topic: str
    slots: Dict[str, Any]


class Recipe:
    """The topics and messages of a recipe's folder."""

    def __init__(self, folder: Path):
        self.folder = folder
        spec: Any = spec_from_file_location(f"{folder.name}_messages", str(folder / "messages.py"))
        found: Any = module_from_spec(spec)
        spec.loader.exec_module(found)
        self.topics: Dict[str, str] = found.TOPICS
        self._messages = found.messages

    def messages(self) -> Iterator[Message]:
        """Yield the messages in the order of their times."""
        made = [
            Message(START * SECOND + round(time * SECOND), topic, slots)
            for time, topic, slots in self._messages()
        ]
        yield from sorted(made, key=lambda message: message.time)


def make_bag(folder: Path, path: Path, definitions: Optional[Definitions] = None) -> None:
    """Write the bag of a recipe, in the place of one that is there."""
    recipe = Recipe(folder)
    known = Definitions() if definitions is None else definitions
    if path.exists():
        path.unlink()
    with BagWriter(path) as bag:
        connections = {topic: bag.add(topic, known.find(kind)) for topic, kind in recipe.topics.items()}
        for time, topic, slots in recipe.messages():
            kind = known.find(recipe.topics[topic])
            data = known.encoder(kind).encode(to_term(kind, slots, time), topic)
            bag.write(connections[topic], time, data)


def to_term(definition: Definition, slots: Dict[str, Any], time: int) -> Term:
    """Return a message as a term; ``time`` in nanoseconds is the stamp of a header that has none."""
    unknown = set(slots) - {field.name for field in definition.fields}
    if unknown:
        raise SystemExit(f"{definition.name} has no slot {', '.join(sorted(unknown))}")
    if not definition.fields:
        return atom(definition.functor_name)
    arguments = [_slot(field, slots.get(field.name), time) for field in definition.fields]
    return functor(definition.functor_name, len(arguments))(*arguments)


def _slot(field: Any, value: Any, time: int) -> Term:
    if field.length is not None:
        element = field._replace(length=None)
        values: List[Any] = [None] * max(field.length, 0) if value is None else value
        return make_list([_slot(element, one, time) for one in values])
    if field.definition is not None:
        return to_term(field.definition, {} if value is None else value, time)
    if field.type in ("time", "duration"):
        return make_list(divmod(_nanoseconds(field, value, time), SECOND))
    if field.type == "string":
        return atom(f'"{value or ""}"')
    if field.type == "bool":
        return atom("true" if value else "false")
    return 0 if value is None else value


def _nanoseconds(field: Any, value: Any, time: int) -> int:
    """Return a time or duration; times that are given count from the beginning of the bag, as those of messages."""
    if value is None:
        return time if field.name == "stamp" else 0
    return round(value * SECOND) + (START * SECOND if field.type == "time" else 0)


def main() -> int:
    """Do what the command line says."""
    parser = argparse.ArgumentParser(description=__doc__.partition("\n")[0])
    parser.add_argument("recipe", type=Path, help="the recipe's folder")
    parser.add_argument(
        "--output", type=Path, metavar="BAG", help="NAME.bag in the recipe's folder, if not given"
    )
    options = parser.parse_args()
    if not (options.recipe / "messages.py").is_file():
        parser.error(f"{options.recipe} is no recipe: it has no messages.py")
    path = options.output or options.recipe / f"{options.recipe.resolve().name}.bag"
    try:
        make_bag(options.recipe, path)
    except RetalisError as error:
        print(f"make_bag: {error}", file=sys.stderr)
        return 1
    print(path)
    return 0


if __name__ == "__main__":
    sys.exit(main())
