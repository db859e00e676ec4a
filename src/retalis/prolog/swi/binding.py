"""The functions of SWI-Prolog's library that are called here, and the start of it in this process."""

import ctypes
from ctypes import POINTER, c_char_p, c_double, c_int, c_int64, c_size_t, c_void_p
from functools import lru_cache
from glob import glob
from typing import Any, Callable, Dict

from ...foundation import PYPY, UsageError
from .signalstack import signal_stack_kept

NAMES = ("libswipl.so.9", "libswipl.so.10", "libswipl.so.8", "libswipl.so.7", "libswipl.so")
"""Of the library, as the loader of the system finds it."""

PLACES = (
    "/usr/lib/swi-prolog/lib/*/libswipl.so*",
    "/usr/lib/swipl/lib/*/libswipl.so*",
    "/usr/local/lib/swipl/lib/*/libswipl.so*",
)
"""Where the loader does not look: SWI-Prolog's own folders."""

MISSING = (
    "use_swi needs SWI-Prolog, which is not installed here: ./install.py --with-swi installs it, "
    "as apt install swi-prolog-nox does"
)

OLDEST = "7.6.4"
"""All that is called here is in it."""

ON_PYPY = "use_swi needs CPython: PyPy lets go of its lock in each call of a library"

# As its argument vector: no handlers of signals but the one that interrupts a system call, no file of the user's.
_ARGUMENTS = (b"swipl", b"--nosignals", b"-q", b"-f", b"none", b"-F", b"none", b"--nodebug")

NODEBUG, CATCH, STATUS = 0x4, 0x8, 0x40
ASK = NODEBUG | CATCH | STATUS
"""How queries are opened: exceptions are ours, and the last solution is told as such."""

RAISED, FAILED, SOLVED, LAST_SOLVED = -1, 0, 1, 2
"""What a query says when it is asked for a solution."""

ATOM_TEXT, STRING_TEXT, INTEGER_TEXT = 0x1, 0x2, 0x8
_FLAGS = ((0x100000, 0x80), (0x1000, 0x40))
"""The flags for texts in UTF-8 and for terms as text: of SWI-Prolog 8.5 and later, and of those before."""

Called = Callable[..., Any]

Answering = ctypes.CFUNCTYPE(c_size_t, c_size_t)
"""The kind of a predicate of arity 1 that is a function of ours."""


class SwiLibrary:
    """SWI-Prolog's functions: those that are short keep Python's lock, those that run goals let it go.

    To let it go costs a thread that wants it back up to 5 ms where others are busy: once for each goal is enough.

    Args:
        library: the path or name of the library.

    Attributes:
        kinds: what ``term_type`` says of a variable, an atom, and so on; it differs between versions.
        utf8: the flag for texts in UTF-8.
        written: the flag for any term as text.
        atom: the flag for a text that is to be an atom.
    """

    def __init__(self, library: str):
        short = ctypes.PyDLL(library, mode=ctypes.RTLD_GLOBAL)
        long = ctypes.CDLL(library, mode=ctypes.RTLD_GLOBAL)

        def known(name: str, result: Any, *arguments: Any, of: ctypes.CDLL = short) -> Called:
            function = of["PL_" + name]
            function.restype, function.argtypes = result, arguments
            return function

        term, handle, text = c_size_t, c_size_t, c_char_p
        self.initialise = known("initialise", c_int, c_int, POINTER(c_char_p), of=long)
        # Engines
        self.create_engine = known("create_engine", c_void_p, c_void_p)
        self.destroy_engine = known("destroy_engine", c_int, c_void_p, of=long)
        self.set_engine = known("set_engine", c_int, c_void_p, POINTER(c_void_p))
        self.attach_thread = known("thread_attach_engine", c_int, c_void_p)
        self.thread_self = known("thread_self", c_int)
        # Queries
        self.predicate = known("predicate", c_void_p, text, c_int, text)
        self.predicate_of = known("pred", c_void_p, handle, c_void_p)
        self.new_module = known("new_module", c_void_p, handle)
        self.open_query = known("open_query", c_size_t, c_void_p, c_int, c_void_p, term)
        self.next_solution = known("next_solution", c_int, c_size_t, of=long)
        self.close_query = known("close_query", c_int, c_size_t, of=long)
        self.close_done = known("close_query", c_int, c_size_t)  # of a query that has nothing left to run
        self.current_query = known("current_query", c_size_t)
        self.exception = known("exception", term, c_size_t)
        self.raise_exception = known("raise_exception", c_int, term)
        self.clear_exception = known("clear_exception", None)
        self.handle_signals = known("handle_signals", c_int, of=long)
        self.call_predicate = known("call_predicate", c_int, c_void_p, c_int, c_void_p, term, of=long)
        self.register = known("register_foreign_in_module", c_int, text, text, c_int, c_void_p, c_int)
        # Terms
        self.open_frame = known("open_foreign_frame", c_size_t)
        self.discard_frame = known("discard_foreign_frame", None, c_size_t)
        self.new_refs = known("new_term_refs", term, c_int)
        self.copy_ref = known("put_term", c_int, term, term)
        self.read_text = known("chars_to_term", c_int, text, term)
        self.new_functor = known("new_functor", handle, handle, c_int)
        self.register_atom = known("register_atom", None, handle)
        self.unregister_atom = known("unregister_atom", None, handle)
        self.unify = known("unify", c_int, term, term)
        self.unify_integer = known("unify_int64", c_int, term, c_int64)
        self.unify_float = known("unify_float", c_int, term, c_double)
        self.unify_atom = known("unify_atom", c_int, term, handle)
        self.unify_nil = known("unify_nil", c_int, term)
        self.unify_text = known("unify_chars", c_int, term, c_int, c_size_t, c_char_p)
        self.unify_functor = known("unify_functor", c_int, term, handle)
        self.unify_list = known("unify_list", c_int, term, term, term)
        self.put_text = known("put_string_chars", c_int, term, text)
        self.term_type = known("term_type", c_int, term)
        self.is_attributed = known("is_attvar", c_int, term)
        self.is_acyclic = known("is_acyclic", c_int, term)
        self.get_atom = known("get_atom", c_int, term, POINTER(c_size_t))
        self.get_integer = known("get_int64", c_int, term, POINTER(c_int64))
        self.get_float = known("get_float", c_int, term, POINTER(c_double))
        self.get_text = known("get_nchars", c_int, term, POINTER(c_size_t), POINTER(c_void_p), c_int)
        self.get_name = known("get_name_arity", c_int, term, POINTER(c_size_t), POINTER(c_int))
        self.get_functor = known("get_functor", c_int, term, POINTER(c_size_t))
        self.get_argument = known("get_arg", c_int, c_int, term, term)
        self.get_list = known("get_list", c_int, term, term, term)
        self.kinds: Dict[str, int] = {}
        self.utf8 = self.written = 0
        self.atom = 2

    def start(self) -> None:
        """Start SWI-Prolog, and leave it for engines to be used.

        Raises:
            UsageError: where it does not start.
        """
        given = (c_char_p * (len(_ARGUMENTS) + 1))(*_ARGUMENTS)
        with signal_stack_kept():
            started = self.initialise(len(_ARGUMENTS), given)
        if not started:
            raise UsageError("SWI-Prolog does not start: its library is there, its own files are not")
        self._look_at_terms()

    def leave(self) -> None:
        """Have this thread use no engine."""
        self.set_engine(None, None)

    def _look_at_terms(self) -> None:
        """Find out how this version names the kinds of terms: by asking for the kind of one of each."""
        frame = self.open_frame()
        ref = self.new_refs(2)
        self.kinds["variable"] = self.term_type(ref)
        samples = {"atom": b"a", "integer": b"1", "float": b"1.5", "nil": b"[]", "pair": b"[a]"}
        for name, text in {**samples, "compound": b"f(x)", "rational": b"1r3", "dict": b"_{a: 1}"}.items():
            read = self.read_text(text, ref)
            kind = self.term_type(ref) if read else 0
            self.kinds[name] = kind if kind not in self.kinds.values() else 0
        self.clear_exception()
        self.put_text(ref, b"text")
        self.kinds["string"] = self.term_type(ref)
        sample = "\u0430".encode()
        for flag, written in _FLAGS:
            self.read_text(b"'\\u0430'", ref)
            length, place = c_size_t(), c_void_p()
            got = self.get_text(ref, ctypes.byref(length), ctypes.byref(place), ATOM_TEXT | flag)
            if got and ctypes.string_at(place.value or 0, length.value) == sample:
                self.utf8, self.written = flag, written
                break
        self.discard_frame(frame)


@lru_cache(maxsize=1)
def find_library() -> SwiLibrary:
    """Return the library's functions, without starting it.

    Raises:
        UsageError: where SWI-Prolog is not installed, or is too old, or this is PyPy.
    """
    if PYPY:
        raise UsageError(ON_PYPY)
    too_old = ""
    for name in (*NAMES, *(path for place in PLACES for path in sorted(glob(place)))):
        try:
            return SwiLibrary(name)
        except OSError:  # not there: the next one
            continue
        except AttributeError as error:  # there may be a newer one
            too_old = f"{name} is older, or another library: {error}"
    raise UsageError(f"use_swi needs SWI-Prolog {OLDEST} or later: {too_old}" if too_old else MISSING)
