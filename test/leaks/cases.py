"""Things that are added and removed again, and things that occur once: one case for each.

A case sets up what its rounds need and returns a function that executes the round of a number.
"""

import struct
from typing import Any, Callable, Dict

from asserting_accessors import stream_clock
from message_registries import empty_registry

from retalis import Engine, Operators, Reports, RetalisError, Settings, atom, functor
from retalis.prolog.syntax.event_text import EventReader, event_text, to_text
from retalis.prolog.syntax.term_reader import read_term

Round = Callable[[int], Any]
CASES: Dict[str, Callable[[], Round]] = {}


def case(make: Callable[[], Round]) -> Callable[[], Round]:
    """Register a case: a function that sets it up and returns a function of the round's number."""
    CASES[make.__name__] = make
    return make


def engine(rules: str = "", **settings: Any) -> Engine:
    made = Engine(settings=Settings(**settings))
    made.load(rules=rules)
    return made


def goals(*texts: str, rules: str = "") -> Round:
    """Return a round that calls goals; # in their texts is the round's number."""
    one = engine(rules)

    def do(number: int) -> None:
        for text in texts:
            one.call(text.replace("#", str(number)))

    return do


# ---- things that are added and deleted ----


@case
def subscriptions() -> Round:
    return goals(
        "subscribe(hot(W,T), [T > #, member(W, [a,b_#])], out(W), topic_#, id_#)",
        "delete_subscription(topic_#, id_#)",
    )


@case
def subscriptions_of_new_events() -> Round:
    return goals("subscribe(hot_#(W,T), [], out_#(W), topic, id)", "delete_subscription(topic, id)")


@case
def memories() -> Round:
    one = engine()

    def do(number: int) -> None:
        one.call(f"memorize(hot(W,T), [T > {number}], m_{number}(W), hot_{number}, 10)")
        one.event(f"hot(w_{number}, {number + 1})", number)
        one.call(f"delete_memory(hot_{number})")

    return do


@case
def event_rules() -> Round:
    one = engine("q(_).")

    def do(number: int) -> None:
        rule = f"(out(W) <- (hot(W,T) seq cold(W)) within 60 where (T > {number}, q(W)))"
        one.call(f"ins_event_rule({rule})")
        one.event(f"hot(w_{number}, {number + 1})", number)
        one.call(f"del_event_rule({rule})")

    return do


@case
def event_rules_of_new_events() -> Round:
    one = engine()

    def do(number: int) -> None:
        one.call(
            f"ins_event_rule((l_{number} : (out_{number}(W) <- hot_{number}(W,c_{number}) seq cold(W))))"
        )
        one.event(f"hot_{number}(w, c_{number})", number)
        one.call(f"del_event_rule(l_{number})")
        assert not one.rules.rules

    return do


@case
def clauses() -> Round:
    return goals(
        "assertz(fact(#))",
        "assertz((rule(X) :- X > #, fact(X)))",
        "rule(0) ; true",
        "retract(fact(#))",
        "retract((rule(_) :- _))",
    )


@case
def clauses_of_new_predicates() -> Round:
    return goals(
        "assertz(fact_#(a_#))",
        "fact_#(_)",
        "retract(fact_#(_))",
        "assertz((rule_# :- X = #, X > 0))",
        "(rule_# -> true ; true)",
        "abolish(rule_#/0)",
    )


@case
def clauses_that_are_called() -> Round:
    return goals(
        "assertz((r_#(X) :- X > 1, \\+ X = #))",
        "forall(between(1, 20, X), (r_#(X) ; true))",
        "retractall(r_#(_))",
    )


@case
def alarms() -> Round:
    one = engine("late(X) <- start(X). exceptionAlarm([alarm(X), 1]) <- start(X).")

    def do(number: int) -> None:
        one.event(f"start(s_{number})", 10 * number)
        stream_clock(one).move_to((10 * number + 5) * 10**9)
        one.advance()

    return do


@case
def waiting_queries() -> Round:
    one = engine("synchronized(done(X), prev(m, _, _, _, _) , [[m, T]]) <- ask(X, T).")

    def do(number: int) -> None:
        one.call("memorize(hot(_), [], _, m, 5)")
        one.event(f"ask(a_{number}, {2.0 * number + 1})", 2 * number)
        one.event(f"hot(h_{number})", 2 * number + 1)
        one.event(f"ask(a_{number}, {2.0 * number + 5})", 2 * number + 1)
        one.call("delete_memory(m)")

    return do


@case
def partial_matches() -> Round:
    one = engine("out(X) <- (hot(X) seq cold(X)) within 5.")

    def do(number: int) -> None:
        stream_clock(one).move_to(number * 10**9)
        one.event(f"hot(h_{number})", number)

    return do


@case
def counters() -> Round:
    return goals("incCounter(c_#)", "resetCounter(c_#)", "set_flag(f_#, 1)", "set_flag(f_#, nil)")


@case
def flags_of_the_network() -> Round:
    return goals("set_etalis_flag(store_fired_events, on)", "set_etalis_flag(store_fired_events, off)")


@case
def operators() -> Round:
    return goals("op(700, xfx, op_#)", "op(0, xfx, op_#)")


@case
def tables() -> Round:
    return goals("t(#)", "abolish_all_tables", rules=":- table t/1. t(X) :- X > 0.")


@case
def rule_files() -> Round:
    one = engine()

    def do(number: int) -> None:
        one.load(rules=f"out_{number}(X) <- in_{number}(X, c_{number}) where p_{number}(X).\np_{number}(_).")
        one.call("reset_etalis")
        one.call(f"abolish(p_{number}/1)")

    return do


@case
def refused_rule_files() -> Round:
    one = engine()

    def do(number: int) -> None:
        try:
            one.load(rules=f"out_{number}(X) <- in_{number}(X). p_{number}(_). q_{number} :- .")
        except RetalisError:
            pass

    return do


# ---- things that occur once ----


@case
def event_names() -> Round:
    one = engine("out(X) <- in(X).")
    return lambda number: one.event(f"in_{number}(a)", number)


@case
def derived_event_names() -> Round:
    stamp = "datime(2000,1,1,0,0,0,1)"
    one = engine(
        f"null_event do (atom_concat(new_, X, N), E =.. [N, X], new_event(E, [{stamp},{stamp}])) <- in(X)."
    )
    return lambda number: one.event(f"in(e_{number})", number)


@case
def event_constants() -> Round:
    one = engine("out(X) <- in(a, X). out(X) <- in(b, X).")
    one.call("memorize(in(_, _), [], _, m, 10)")
    return lambda number: one.event(f"in(c_{number}, {number})", number)


@case
def queries() -> Round:
    one = engine("p(_).")

    def do(number: int) -> None:
        one.query(f"findall(X, (p(X), \\+ X == c_{number}), L_{number}), forall(p(X), X \\== d_{number})")

    return do


@case
def unknown_procedures() -> Round:
    one = engine("p(_).")

    def do(number: int) -> None:
        try:
            one.call(f"unknown_{number}(a)")
        except RetalisError:
            pass

    return do


@case
def event_texts() -> Round:
    one = engine("out(X) <- in(X).")
    return lambda number: one.post_text(
        f"event(in('\"t{number}\"',{number}),[datime(2000,1,1,0,0,0,1),datime(2000,1,1,0,0,0,1)])"
    )


@case
def event_shapes() -> Round:
    one = engine("out(X) <- in(X).")
    return lambda number: one.post_text(f"event(in(name_{number}(1,2),[{'1,' * (number % 1000)}1]))")


@case
def refused_texts() -> Round:
    one = engine(queue=10)
    return lambda number: one.post_text(f"shell({number}, '{'x' * 2000}')")


@case
def wrong_texts() -> Round:
    one = engine(queue=10)
    return lambda number: one.post_text(f"event(in_{number}({'x' * 2000}")


@case
def reports() -> Round:
    made = Reports()

    def do(number: int) -> None:
        made.error(RetalisError(f"{number}" + "x" * 5000))
        made.warning(f"{number}" + "x" * 5000)
        made.warning(f"{number}" + "x" * 5000, "kind", 20)

    return do


@case
def texts_to_terms() -> Round:
    operators_ = Operators.prolog()
    return lambda number: read_term(
        f"f_{number}('q {number}', \"s{number}\", X_{number})", operators_, "text"
    )


@case
def long_texts_of_terms() -> Round:
    return lambda number: to_text(functor("f", 1)(atom(f"Long {number}" + "x" * 20_000)))


@case
def output_texts() -> Round:
    reader = EventReader()
    return lambda number: reader.read(f"event(out_{number}('a b',{number}),t_{number},i)")


@case
def message_types() -> Round:
    known = empty_registry()

    def do(number: int) -> None:
        definition = known.add(
            "p/T",
            f"string s\nint32 n{number}\nfloat64[] d\np/U{number} u\n"
            + "=" * 80
            + f"\nMSG: p/U{number}\nint8 x\n",
        )
        decoder = known.decoder(definition)
        term = decoder.decode(struct.pack("<I5siIdb", 5, b"hello", 1, 1, 0.5, 3))
        known.encoder(definition).encode(term)

    return do


@case
def unknown_message_types() -> Round:
    known = empty_registry()
    return lambda number: f"p/T{number}" in known


@case
def message_texts() -> Round:
    known = empty_registry()
    definition = known.add("p/T", "string s\nstring[] t\n")
    decoder, encoder = known.decoder(definition), known.encoder(definition)

    def do(number: int) -> None:
        text = b"%d" % number + b"x" * (number % 3000)
        packed = struct.pack("<I", len(text)) + text
        term = decoder.decode(packed + struct.pack("<I", 1) + packed)
        encoder.encode(term)
        event_text(to_text(term), number * 10**9)

    return do
