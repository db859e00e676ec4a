"""Which arguments of predicates are goals, closures, clauses or names of predicates: there a module's names hold."""

from typing import Dict, List, Tuple, Union

from ..terms import Functor, functor

ArgumentKind = Union[int, str]
"""What an argument is.

A number is that of the arguments that are added to it before it is called, 0 for a goal. ``^`` is a goal after
``Variable^``, ``:`` anything that belongs to a module, ``clause`` a clause to be added, ``match`` one to be found,
``head`` a head, ``names`` indicators of what is declared, ``named`` of what is there. Anything else is plain.
"""

ArgumentKinds = Tuple[ArgumentKind, ...]

PLAIN: ArgumentKind = "?"


def _kinds(text: str) -> Dict[Functor, ArgumentKinds]:
    found: Dict[Functor, ArgumentKinds] = {}
    for entry in text.split():
        name, _, rest = entry.rpartition("(")
        kinds = tuple(int(one) if one.isdigit() else one for one in rest.rstrip(")").split("|"))
        found[functor(name, len(kinds))] = kinds
    return found


METAS: Dict[Functor, ArgumentKinds] = _kinds(
    """
    ,(0|0) ;(0|0) |(0|0) ->(0|0) *->(0|0) \\+(0) not(0) once(0) ignore(0) forall(0|0) catch(0|?|0)
    call(0) call(1|?) call(2|?|?) call(3|?|?|?) call(4|?|?|?|?) call(5|?|?|?|?|?) call(6|?|?|?|?|?|?)
    call(7|?|?|?|?|?|?|?) apply(:|?) findall(?|0|?) findall(?|0|?|?) findnsols(?|?|0|?) findnsols(?|?|0|?|?)
    bagof(?|^|?) setof(?|^|?) aggregate_all(?|0|?) aggregate_all(?|?|0|?) aggregate(?|^|?)
    setup_call_cleanup(0|0|0) call_cleanup(0|0) with_output_to(?|0) call_with_time_limit(?|0)
    call_with_inference_limit(0|?|?) limit(?|0) offset(?|0) call_nth(0|?) freeze(?|0) when(?|0) assertion(0)
    trace(0) time(0) initialization(0) initialization(0|?)
    maplist(1|?) maplist(2|?|?) maplist(3|?|?|?) maplist(4|?|?|?|?) maplist(5|?|?|?|?|?) maplist(6|?|?|?|?|?|?)
    foldl(3|?|?|?) foldl(4|?|?|?|?) foldl(5|?|?|?|?|?) foldl(6|?|?|?|?|?|?) foldr(3|?|?|?)
    include(1|?|?) exclude(1|?|?) partition(1|?|?|?) partition(2|?|?|?|?|?) predsort(3|?|?) max_member(2|?|?)
    min_member(2|?|?) map_assoc(1|?) map_assoc(2|?|?) convlist(2|?|?)
    aggregate(?|?|^|?) foreach(0|0) group_by(?|?|0|?) scanl(3|?|?|?) sublist(1|?|?) checklist(1|?) order_by(?|0)
    mapargs(2|?|?) mapsubterms(2|?|?)
    phrase(:|?) phrase(:|?|?) phrase_from_file(:|?) phrase_from_file(:|?|?) phrase_from_stream(:|?)
    assert(clause) asserta(clause) assertz(clause) retract(match) retractall(head)
    clause(head|?) abolish(named) dynamic(names) discontiguous(names) multifile(names) table(names)
    public(names) volatile(names) module_transparent(names) current_predicate(named) predicate_property(head|?)
    meta_predicate(names) nth_clause(head|?|?) strip_module(:|?|?) listing(named)
    """
)
"""Those of the system."""


def declared_kinds(args: Tuple[object, ...]) -> ArgumentKinds:
    """Return what the arguments of a predicate are, as ``meta_predicate/1`` says by integers and modes."""
    kinds: List[ArgumentKind] = []
    for arg in args:
        if isinstance(arg, int):
            kinds.append(arg)
        else:
            name = getattr(arg, "name", "")
            kinds.append({"^": "^", ":": ":", "//": ":"}.get(name, PLAIN))
    return tuple(kinds)
