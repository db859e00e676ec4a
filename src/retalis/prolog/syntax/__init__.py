r"""Text to terms and back: Prolog with SWI-Prolog's extensions, and the event language's operators.

* `read_term` reads one term, `read_program` a whole text clause by clause; both give `ReadTerm` objects:
  the term, its variables by name, and the places of its parts. Errors are `SyntaxFault` only.
* `Operators` is the operator table that they read with, `ReadFlags` says how quotes read.
* `EventReader` reads event text, fast for shapes that it has seen; `to_text` and `event_text` write it.
* `write_term` and `writeq` write terms that read back.

Event rules come out with canonical functors, however their operators are spelt (``rules.py`` says which
part of a clause is a pattern, where ``*``, ``#``, ``/\`` and ``\/`` are event operators):

    Head <- Pattern                 <-(Head, Pattern)           also iff, 'IFF'
    Head do Goal <- Pattern         <-(do(Head, Goal), Pattern)
    Pattern do Goal                 do(Pattern, Goal)
    Label : Rule                    'rule:'(Label, Rule)        also 'rule:'
    a seq b, a 'Seq' b, a * b       seq(a, b)                   the same for and, or, par, ...

``nan``, ``inf`` and ``-inf`` are floats in event text only (`ReadFlags.event_text`); in programs they are
atoms, and the floats are written ``1.5NaN``, ``1.0Inf``, ``-1.0Inf``. In event text ``"text"`` is the atom
``'"text"'``; elsewhere it is what the flag ``double_quotes`` says.

What SWI-Prolog 9 reads and this package does not: rational numbers (``1r3``), dicts, block functors,
terms without arguments (``f()``), and a blank between groups of digits (``1 000``).
"""

from .eventoperators import EVENT_OPERATOR, EVENT_OPERATORS, EventOperator, OperatorKind
from .eventreader import EventReader
from .eventtext import event_text, to_text
from .numerals import integer
from .operators import DECLARE_EVENT, Operator, Operators
from .reader import OF_FILES, Program, ReadTerm, read_program, read_term
from .shownslots import by_name
from .slots import Meant, MessageSlot, NamedForm
from .tokens import ReadFlags
from .writer import add_full_stop, beginning_of, canonical_text, write_term, writeq

__all__ = [
    "add_full_stop",
    "beginning_of",
    "canonical_text",
    "by_name",
    "DECLARE_EVENT",
    "EVENT_OPERATOR",
    "EVENT_OPERATORS",
    "event_text",
    "EventOperator",
    "EventReader",
    "integer",
    "OF_FILES",
    "Operator",
    "OperatorKind",
    "Meant",
    "MessageSlot",
    "NamedForm",
    "Operators",
    "Program",
    "read_program",
    "read_term",
    "ReadFlags",
    "ReadTerm",
    "to_text",
    "write_term",
    "writeq",
]
