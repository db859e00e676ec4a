"""Base class and helpers of all kinds of inputs."""

import logging
from pathlib import Path
from typing import Any, List

import numpy  # noqa: F401 - predicates on arrays import it at the first call, and no input may import a module

from retalis import Engine, Limits, RetalisError, Settings

from ..mutate import to_text
from ..side_effects import MAX_CPU_SECONDS, MAX_GROWTH_BYTES, FindingError

try:  # message types are searched in it, and no input may import a module
    from rosbags.typesys import Stores, get_typestore
except ImportError:
    pass
else:
    get_typestore(Stores.ROS1_NOETIC)

CORPUS = Path(__file__).resolve().parent.parent / "corpus"
# An input is several events. Each may use the time limit twice if the program catches the error: all within a second.
SETTINGS = Settings(
    limits=Limits(seconds=0.1, inferences=30_000, megabytes=30), max_depth=50, queue=100, folders=()
)

ARGUMENTS = Path(__file__).with_name("arguments.txt").read_text(encoding="utf-8").splitlines()
"""Terms of all kinds, as text."""


class Kind:
    """Generator of the inputs of one kind, which also passes them to the package.

    An input is bytes. Those in the corpus are files, and the lines of ``seeds.txt``.

    Attributes:
        block_size: number of inputs after which `reset` creates the shared objects again.
        may_read_files: whether inputs may read any file.
        seconds: maximum CPU time of an input.
        max_growth: maximum growth of the resident memory during an input, in bytes.
        may_warm_up: whether inputs of the corpus may be processed before the side effects are checked.
        is_isolated: whether each input is processed in a separate process, so that memory that was freed before
            hides no growth.
        accepted_count: number of steps without an error.
        refused_count: number of steps with a documented error.
    """

    block_size = 50
    may_read_files = False
    may_warm_up = True
    is_isolated = False
    seconds = MAX_CPU_SECONDS
    max_growth = MAX_GROWTH_BYTES

    def __init__(self, scratch: Any) -> None:
        self.scratch = scratch
        self.accepted_count = self.refused_count = 0
        self.corpus = corpus(type(self).__module__.rpartition(".")[2])
        self.texts = [to_text(data) for data in self.corpus]
        self.setup()

    def setup(self) -> None:
        """Create the objects that all inputs share and do not change."""

    def reset(self) -> None:
        """Create the objects that inputs change."""

    def generate(self, rng: Any) -> bytes:
        """Return a random input."""
        raise NotImplementedError

    def prepare(self, data: Any) -> None:
        """Do the work outside of the package, whose side effects are not checked."""

    def run(self, data: Any) -> None:
        """Process an input; undocumented errors are raised."""
        raise NotImplementedError

    def marker_of(self, data: Any) -> str:
        """Return the part of an input that must not occur in generated source, or ""."""
        return ""

    def subject(self, data: Any) -> str:
        """Return the name under which findings of an input are grouped; "" to group them by place in the package."""
        return ""

    def attempt(self, work: Any, *arguments: Any) -> Any:
        """Do a step that may raise a documented error; return its result or None."""
        try:
            result = work(*arguments)
        except RetalisError as error:
            str(error)
            error.brief()
            self.refused_count += 1
            return None
        self.accepted_count += 1
        return result


def corpus(kind: Any) -> Any:
    """Return the inputs in the corpus of a kind."""
    inputs: List[Any] = []
    for path in sorted((CORPUS / kind).glob("*")):
        data = path.read_bytes()
        inputs += data.splitlines() if path.name == "seeds.txt" else [data]
    return inputs


class InternalErrorCheck(logging.Handler):
    """Handler that turns an internal error in the log into a finding."""

    def __init__(self) -> None:
        super().__init__()
        self.logged_error = None

    def emit(self, record: Any) -> None:
        text = record.getMessage()
        if "internal error" in text or record.exc_info:
            self.logged_error = text

    def check(self) -> None:
        text, self.logged_error = self.logged_error, None
        if text is not None:
            lines = text.strip().split("\n")
            places = [line.strip() for line in lines if "/retalis/" in line]
            place = places[-1].split("/retalis/")[-1] if places else lines[0]
            raise FindingError("logged", f"{lines[-1]}", place)


LOGGED = InternalErrorCheck()
log = logging.getLogger("retalis")
log.addHandler(LOGGED)


def create_silent_engine(settings: Any = SETTINGS) -> Engine:
    """Return an engine that prints nothing."""
    engine = Engine(settings=settings)
    engine.logic.output = engine.logic.error_output = lambda text: None
    return engine
