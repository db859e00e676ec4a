"""Names of predicates in modules: what a file calls its own is nobody else's name for it.

There is one table of predicates. Those that a module exports have their plain names in it; every other name that is
used in a module's file, and not the system's or imported, stands there with the module's in front: ``p/1`` of module
``m`` is ``m:p/1``. A name of a module that nobody has defined stands for the plain one (`ModuleNames.plain_of`).
"""

from contextlib import contextmanager
from typing import Callable, Dict, Iterable, Iterator, List, Optional, Set, Tuple

from ..compiler import FIXED
from ..machine import permission_error
from ..terms import COLON, SLASH, Atom, CompoundTerm, Functor, Term, atom, deref, functor
from .metas import METAS, ArgumentKinds

GRAMMAR_NAME = functor("//", 2)

_EVERYBODYS = FIXED | {
    *(functor(name, 2) for name in ("term_expansion", "goal_expansion")),
    *(functor("portray", 1), functor("message_hook", 3)),
}
"""What no module has for itself: what is fixed, and what the system asks the program for."""

KeptModule = Tuple[List[Functor], List[Functor], List[str], List[str]]
"""What a module exports and imports, the names of its own, and what those that it imports are called."""


def indicated(term: CompoundTerm) -> Optional[Functor]:
    """Return the functor that ``Name/Arity`` or ``Name//Arity`` names, None where it names none."""
    name, arity = deref(term[1]), deref(term[2])
    if not isinstance(name, Atom) or not isinstance(arity, int):
        return None
    return functor(name.name, arity + (2 if term[0] is GRAMMAR_NAME else 0))


class Module:
    """A module.

    Attributes:
        name: of it.
        mark: the same as an atom.
        exports: its predicates that others call by their plain names.
        hidden: those of them whose plain names another module has had before.
        imports: those of others that it has asked for, and what these are called.
    """

    def __init__(self, name: str):
        self.name = name
        self.mark = atom(name)
        self.exports: Set[Functor] = set()
        self.hidden: Set[Functor] = set()
        self.imports: Dict[Functor, Functor] = {}


EVERYBODY = Module("user")
"""Stands for no module."""


class ModuleNames:
    """The modules of a program.

    Attributes:
        table: by their names.
        metas: what arguments of the program's own predicates are, see `metas`.
        loading: the module whose file is being loaded.
        last: the name of that whose file was loaded last, "" where that was none.
        is_there: tells whether the program has a predicate of a functor.
        is_of_system: tells whether the system has one.
        shared: predicates that are everybody's for now, wherever they are defined.
        on_begin: called with the name of each module whose file begins.
        on_change: called where there is a new one.
        on_clash: called with what cannot be imported.
    """

    def __init__(self) -> None:
        self.table: Dict[str, Module] = {}
        self.shared: Set[Functor] = set()
        self.metas: Dict[Functor, ArgumentKinds] = {}
        self.loading: Optional[Module] = None
        self.last = ""
        self.is_there: Callable[[Functor], bool] = lambda key: False
        self.is_of_system: Callable[[Functor], bool] = lambda key: False
        self.on_begin: Callable[[str], None] = lambda name: None
        self.on_change: Callable[[], None] = lambda: None
        self.on_clash: Callable[[str], None] = lambda text: None
        self._files: List[bool] = []
        self._plain: Dict[str, str] = {}

    @contextmanager
    def of_file(self, may_be_one: bool = True) -> Iterator[None]:
        """Load a file meanwhile: a module that it says it is ends with it.

        Args:
            may_be_one: whether it may be one, and goes on with that of the file that loads it: not one of event
                rules, whose goals belong to nobody.
        """
        before = self.loading
        if not may_be_one:
            self.loading = None
        self._files.append(may_be_one)
        depth = len(self._files)
        try:
            yield
            self.last = "" if self.loading is None or self.loading is before else self.loading.name
        finally:
            self.loading = before
            del self._files[depth - 1 :]

    def begin(self, name: str, exports: Iterable[Functor]) -> bool:
        """Have the rest of the file belong to a module; return whether it may.

        Raises:
            PrologError: where no file is being loaded.
        """
        if not self._files:
            raise permission_error("load", "module", atom(name), "module/2 is a directive of a file")
        if not self._files[-1]:
            return False
        new = name not in self.table
        module = self.table.setdefault(name, Module(name))
        module.exports = set(exports)
        module.hidden = module.exports & self._taken(module)
        for key in sorted(module.hidden, key=str):
            self._clash(module, key, "user", key)
        self.loading = module
        self.on_begin(name)
        if new:
            self.on_change()  # what has been compiled has calls of it without its names
        return True

    def bring_in(self, name: str) -> None:
        """Have the names that a module exports mean its predicates in the file that is being loaded."""
        found = self.table.get(name)
        if found is not None and self.loading is not None and found is not self.loading:
            for key in sorted(found.exports, key=str):
                target = self.own(found, key)
                if self.loading.imports.setdefault(key, target) is not target:
                    self._clash(found, key, self.loading.name, self.loading.imports[key])

    def _taken(self, module: Module) -> Set[Functor]:
        """Return the plain names that other modules have."""
        others = (other for other in self.table.values() if other is not module)
        return {key for other in others for key in other.exports - other.hidden}

    def _clash(self, module: Module, key: Functor, importer: str, there: Functor) -> None:
        before = next(
            (
                one.name
                for one in self.table.values()
                if one is not module and key in one.exports and self.own(one, key) is there
            ),
            "user",
        )
        what = f"{module.name}:{key}"
        self.on_clash(
            f"Warning: no permission to import {what} into {importer}: already imported from {before}; "
            f"{module.name}:{key.name}(...) calls it\n"
        )

    def mend(self) -> None:
        """Go back to where no file is being loaded."""
        self.loading = None
        self.shared.clear()
        self._files.clear()

    def named(self, term: Term) -> Optional[Module]:
        """Return the module that a term names, None where there is no such."""
        term = deref(term)
        return self.table.get(term.name) if isinstance(term, Atom) else None

    # Names

    def plain_of(self, key: Functor) -> Optional[Functor]:
        """Return the plain name of a predicate of a module; None for other predicates."""
        name = self._plain.get(key.name)
        return None if name is None else functor(name, key.arity)

    def shown(self, key: Functor) -> Optional[Term]:
        """Return the indicator of a predicate of a module, as ``m:(p/1)``; None for other predicates."""
        name = self._plain.get(key.name)
        if name is None:
            return None
        return (COLON, atom(key.name[: -len(name) - 1]), (SLASH, atom(name), key.arity))

    def _is_plain(self, module: Module, key: Functor) -> bool:
        if key in module.exports and key not in module.hidden:
            return True
        return key in _EVERYBODYS or key in self.shared or key.name in self._plain

    def own(self, module: Module, key: Functor) -> Functor:
        """Return the functor of a predicate that a module defines."""
        if self._is_plain(module, key):
            return key
        name = f"{module.name}:{key.name}"
        self._plain[name] = key.name
        return functor(name, key.arity)

    def stored(self, module: Module, key: Functor) -> Functor:
        """Return the functor of a predicate that clauses are asserted of in a module: its own, or one it imports."""
        own = self.own(module, key)
        return module.imports[key] if key in module.imports and not self.is_there(own) else own

    def resolve(self, module: Module, key: Functor) -> Functor:
        """Return the functor of the predicate that a name means in a module."""
        if self._is_plain(module, key):
            return key
        if (key in module.imports or self.is_of_system(key)) and not self.is_there(
            functor(f"{module.name}:{key.name}", key.arity)
        ):
            return module.imports.get(key, key)
        return self.own(module, key)

    def restore(self, table: Dict[str, KeptModule]) -> None:
        """Have the modules that `kept` returned."""
        for name, (exports, imports, own, *called) in table.items():
            module = self.table.setdefault(name, Module(name))
            module.exports.update(exports)
            module.hidden = module.exports & self._taken(module)
            names = called[0] if called else [key.name for key in imports]
            module.imports.update({key: functor(one, key.arity) for key, one in zip(imports, names)})
            self._plain.update({f"{name}:{one}": one for one in own})

    def kept(self) -> Dict[str, KeptModule]:
        """Return what there is, as plain data."""
        return {
            name: (
                sorted(module.exports, key=str),
                sorted(module.imports, key=str),
                sorted(plain for whole, plain in self._plain.items() if whole == f"{name}:{plain}"),
                [module.imports[key].name for key in sorted(module.imports, key=str)],
            )
            for name, module in self.table.items()
        }

    def kinds(self, key: Functor) -> Optional[ArgumentKinds]:
        """Return what the arguments of a predicate are, None where all are plain."""
        found = self.metas.get(key)
        if found is None:
            plain = self.plain_of(key)
            if plain is not None and not self.is_there(key):
                key = plain
            found = self.metas.get(key) or METAS.get(key)
        return found
