"""Partial matches: where they wait for partners, which a policy takes, when they are to go."""

from .absence import Absence, Emitting, RuledOutSweep
from .chains import Chain, Log, joined_at_once, joined_one_by_one, pieces_of, repetitions
from .expiry import VISITED_SLICE, ByStart, Expiries, drop_gone
from .matches import (
    NOTHING_HELD,
    Found,
    Held,
    Holder,
    Match,
    Named,
    agreed,
    arrival,
    identity,
    leaves,
    sources,
    taken_back,
    unify_sides,
)
from .modes import AfterMatch, NetworkOptions, Policy, with_property
from .owners import Bounds, Owner
from .places import MatchBuffer, key_function, surely_same
from .policy import (
    Emit,
    Side,
    among_others,
    counted,
    emit_each,
    taking_all,
    taking_all_at_once,
    taking_one,
    waiting_only,
)
from .reach import reach_of
from .revived import Keeping, after_all, first_side, in_order, stands, that_came_before
from .run import NO_ITEMS, Run, by_occurrence, by_term
from .trains import Moving, Token, Train

__all__ = [
    "Absence",
    "after_all",
    "AfterMatch",
    "agreed",
    "among_others",
    "arrival",
    "Bounds",
    "by_occurrence",
    "ByStart",
    "by_term",
    "Chain",
    "counted",
    "drop_gone",
    "Emit",
    "Emitting",
    "emit_each",
    "Expiries",
    "first_side",
    "Found",
    "Held",
    "Holder",
    "identity",
    "in_order",
    "joined_at_once",
    "joined_one_by_one",
    "Keeping",
    "key_function",
    "leaves",
    "Log",
    "Match",
    "NetworkOptions",
    "Moving",
    "Named",
    "NOTHING_HELD",
    "NO_ITEMS",
    "Owner",
    "pieces_of",
    "MatchBuffer",
    "Policy",
    "reach_of",
    "repetitions",
    "RuledOutSweep",
    "Run",
    "Side",
    "sources",
    "stands",
    "surely_same",
    "taken_back",
    "taking_all",
    "taking_all_at_once",
    "taking_one",
    "that_came_before",
    "Token",
    "Train",
    "unify_sides",
    "VISITED_SLICE",
    "waiting_only",
    "with_property",
]
