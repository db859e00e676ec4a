"""Base class and helpers of all kinds of inputs."""

import logging
from pathlib import Path

import numpy  # noqa: F401 - predicates on arrays import it at the first call, and no input may import anything

from retalis import Engine, Limits, RetalisError, Settings

from ..mutate import to_text
from ..side_effects import GROWTH, SECONDS, Finding

try:  # names of types are looked for in it, and no input may import anything
    from rosbags.typesys import Stores, get_typestore
except ImportError:
    pass
else:
    get_typestore(Stores.ROS1_NOETIC)

CORPUS = Path(__file__).resolve().parent.parent / "corpus"
# An input is several events, each with the time twice where a program catches that it is over: all within a second.
SETTINGS = Settings(
    limits=Limits(seconds=0.1, inferences=30_000, megabytes=30), max_depth=50, queue=100, folders=()
)

ARGUMENTS = Path(__file__).with_name("arguments.txt").read_text(encoding="utf-8").splitlines()
"""Terms of all kinds, as text."""


class Kind:
    """Makes inputs of one kind and feeds them to where the package takes them.

    An input is bytes. Those in the corpus are files, and the lines of ``seeds.txt``.

    Attributes:
        block: how many inputs are worked on before `begin` makes everything anew.
        reads: whether inputs may have files anywhere read.
        seconds: CPU time that an input may take.
        growth: bytes by which the resident memory may grow while an input is worked on.
        warm: whether the corpus may be worked on before the watch begins.
        apart: whether each input is worked on in a process of its own, so that memory that was freed before hides
            no growth.
        taken, refused: how many steps ended well, and how many with a documented error.
    """

    block = 50
    reads = False
    warm = True
    apart = False
    seconds = SECONDS
    growth = GROWTH

    def __init__(self, scratch):
        self.scratch = scratch
        self.taken = self.refused = 0
        self.corpus = corpus(type(self).__module__.rpartition(".")[2])
        self.texts = [to_text(data) for data in self.corpus]
        self.setup()

    def setup(self):
        """Prepare what all inputs share."""

    def begin(self):
        """Make anew what inputs change."""

    def make(self, chance):
        """Return an input."""
        raise NotImplementedError

    def prepare(self, data):
        """Do what is no work of the package, before the watch begins."""

    def run(self, data):
        """Work on an input; raises what does not belong to the documented errors."""
        raise NotImplementedError

    def marked(self, data):
        """Return the part of an input that must not come up in a source, or nothing."""
        return ""

    def subject(self, data):
        """Return the name under which findings of an input are collected, or nothing for the place in the package."""
        return ""

    def attempt(self, work, *arguments):
        """Do a step that may end with a documented error; return its result or None."""
        try:
            found = work(*arguments)
        except RetalisError as error:
            str(error)
            error.brief()
            self.refused += 1
            return None
        self.taken += 1
        return found


def corpus(kind):
    """Return the inputs in the corpus of a kind."""
    found = []
    for path in sorted((CORPUS / kind).glob("*")):
        data = path.read_bytes()
        found += data.splitlines() if path.name == "seeds.txt" else [data]
    return found


class Raised(logging.Handler):
    """Raises an internal error that was logged instead of let out."""

    def __init__(self):
        super().__init__()
        self.found = None

    def emit(self, record):
        text = record.getMessage()
        if "internal error" in text or record.exc_info:
            self.found = text

    def check(self):
        text, self.found = self.found, None
        if text is not None:
            lines = text.strip().split("\n")
            places = [line.strip() for line in lines if "/retalis/" in line]
            where = places[-1].split("/retalis/")[-1] if places else lines[0]
            raise Finding("logged", f"{lines[-1]}", where)


LOGGED = Raised()
log = logging.getLogger("retalis")
log.addHandler(LOGGED)


def silent_engine(settings=SETTINGS):
    """Return an engine that prints nothing and raises what it would have logged as its own fault."""
    engine = Engine(settings=settings)
    engine.logic.output = engine.logic.error_output = lambda text: None
    return engine
