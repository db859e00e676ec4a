"""Text to terms and back: Prolog with SWI-Prolog's extensions, and the event language's operators.

* `read_term` reads one term, `read_program` a whole text clause by clause; both give `ReadTerm` objects:
  the term, its variables by name, and the places of its parts.
* `Operators` is the operator table that they read with, `ReadFlags` says how quotes read.
* `write_term` and `writeq` write terms that read back; `to_text` writes event text.

Event rules (see `rules`) come out with canonical functors, however their operators are spelt::

    Head <- Pattern                 '<-'(Head, Pattern)      also iff, 'IFF'
    Head do Goal <- Pattern         '<-'(do(Head, Goal), Pattern)
    Pattern do Goal                 do(Pattern, Goal)
    Label : Rule                    'rule:'(Label, Rule)     also 'rule:'
    a seq b, a 'Seq' b, a * b       seq(a, b)                the same for and, or, par, ...
"""

from .eventreader import EventReader
from .eventtext import to_text
from .operators import Operators
from .reader import Program, ReadTerm, read_program, read_term
from .tokens import ReadFlags
from .writer import WriteOptions, write_term, writeq

__all__ = [
    "EventReader",
    "Operators",
    "Program",
    "ReadFlags",
    "ReadTerm",
    "WriteOptions",
    "read_program",
    "read_term",
    "to_text",
    "write_term",
    "writeq",
]
