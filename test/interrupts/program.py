"""A program that uses much of the language, actions on it that are interrupted, and probes of what it answers then.

All that an action leaves waiting has the action's number as a value of its own, so a probe with another number has
to be answered the same whatever an interrupt has left undone of the actions before it.
"""

from functools import lru_cache

from events.stream_programs import term_text

from retalis import Engine, Limits, Operators, PrologError, Settings, StreamClock, atom
from retalis.prolog.syntax.term_reader import read_term
from retalis.prolog.terms.term_traversal import copy
from retalis.prolog.terms.timestamps import SECOND

RULES = """
:- table path/2.
:- dynamic told/1, level/2, remark/2.
odd(X) :- X mod 2 =:= 1.
edge(1,2). edge(2,3). edge(3,1). edge(3,4).
path(X,Y) :- edge(X,Y).
path(X,Y) :- path(X,Z), edge(Z,Y).
fact(0,1) :- !.
fact(N,F) :- M is N-1, fact(M,G), F is N*G.
bump(K) :- ( retract(level(K,V)) -> true ; V = 0 ), W is V+1, assertz(level(K,W)).
note(K,T) :- retractall(remark(K,T)), assertz(remark(K,T)), asserta(remark(K,first)).
guarded(X,Y) :- setup_call_cleanup(nb_setval(open,X), (member(Y,[1,2,3]), Y >= X), nb_setval(open,closed)).
text(X,A) :- with_output_to(atom(A), (write(X), nl, writeq('It')) ).
colour(red). colour(green). colour(blue).
bounded(N) :- call_with_time_limit(60, fact(N,_)), call_with_inference_limit(fact(N,_), 1000000, _).

pair(K,Y) <- a(K) seq b(K,Y).
both(K) <- a(K) and c(K).
any(K) <- b(K,_) or c(K).
inside(K) <- c(K) during pair(K,_).
alone(K) <- (a(K) seq d(K)) cnot c(K).
never(K) <- d(K) fnot e(K).
tour(K,N) <- a(K) seq aggregate(sum(Y), b(K,Y), N).
route(K) <- a(K) seq (b(K,_) star_times).
asked(K,F) <- b(K,Y) where (fact(Y,F), \\+ F = 7, findall(C, colour(C), [_|_])).
guard(K) <- c(K) where (guarded(2,_), catch(throw(x), _, true), once(path(1,_))).
done(K) do bump(K) <- a(K) where (bounded(3), text(K,_)).
noted(K) do note(K,b) <- b(K,_).
level(K,V) <- done(K) where level(K,V).
exceptionAlarm(late(K), 5) <- a(K).
syncronized(answer(K,V), (prev(m, v(K,V), _, _, T)), [[m, T]]) <- ask(K,T).
v(K,Y) <- b(K,Y).
deep(K,N) <- start(K,N).
deep(K,M) <- deep(K,N) where (N > 0, M is N-1).
bottom(K) <- deep(K,0).
:- state(running(K), from(start(K,_)), until(e(K)), [within(12)]).
:- state(open(K), from(c(K)), until(d(K))).
:- timer(beat, every(7)).
held(K) <- b(K,_) where holds(open(K)).
over(K,N) <- running(K) where N = 1.
timed(K) do timer(rung(K), after(4)) <- c(K).
"""

GOALS = """
memorize(v(_,_), [], _, m, 20)
memorize(b(K,Y), [odd(Y)], odd(K,Y), n, 6)
memorize(c(_), [], _, c, 4)
subscribe(pair(_,_), [], _, pairs, p)
subscribe(answer(K,V), [V > 0], said(K,V), answers, q)
"""

QUERIES = (
    "path(1,X)",
    "findall(F, (between(1,8,N), fact(N,F)), L)",
    "guarded(1,Y)",
    "catch((guarded(1,Y), throw(ball(Y))), ball(Z), true)",
    "text(f(x,[1,2]),A)",
    "( member(X,[1,2,3]), X > 1 -> true ; X = 0 ), \\+ X = 3",
    "aggregate_all(count, colour(_), C), setof(X, colour(X), L)",
    "bounded(6), call_with_inference_limit(member(X,[a,b]), 100000, R)",
    "forall(member(X,[1,2]), fact(X,_)), b_setval(b, 1), b_getval(b, B)",
    "access_mem(m, v(K,V), [T1,T2]), K < 0",
    "catch(call_with_time_limit(60, (repeat, fail)), _, true)",
)
"""Goals without effects that last; the last one is for limits only."""

ACTIONS = (
    "event a({k})",
    "event b({k},3)",
    "event c({k})",
    "event d({k})",
    "event start({k},9)",
    "event ask({k},{t})",
    "event e({k})",
    "event b({k},5)",
    "call bump({k}), bump({k}), retractall(level({k},_)), assertz(level({k},7))",
    "call note({k},x), note({k},y), retractall(remark({k},_))",
    "call new_event(a({k}), [{t},{t}]), new_event(b({k},1), [{t},{t}])",
    "call memorize(extra({k}), [], _, extra({k}), 5), delete_memory(extra({k}))",
    "load extra{k}(K) <- a(K) seq extra(K,{k}).\nextra{k}_(1). extra{k}_(2).\n",
    "load :- assertz(told({k})).\nextra{k}(K) <- a(K) and c(K).\nloaded{k}(1).\nloaded{k}(2).\n",
)

SETUP = ("a({k})", "b({k},1)", "ask({k},{later})")

PROBE = (
    "a({k})",
    "ask({k},{later})",
    "b({k},3)",
    "c({k})",
    "d({k})",
    "b({k},4)",
    "start({k},7)",
    "end",
    "e({k})",
)

ANSWERS = (
    "level({k},V)",
    "remark({k},T)",
    "prev(m,v(K,V),_,_,{t})",
    "prev(n,X,_,_,{t})",
    "prev(c,X,_,_,{t})",
    "memory_size(m,N)",
    "bump({k}),level({k},V)",
    "note({k},z),findall(T,remark({k},T),L)",
    "nb_getval(open,V)",
    "findall(X-Y,path(X,Y),L),length(L,N)",
    "current_output(S),text(a,A)",
    "told({k})",
    "holds(open({k}),Since)",
    "holds_at(running({k}),{t})",
)


@lru_cache(maxsize=None)
def _read(template):
    read = read_term(template.format(k="K_", t="T_", later="L_"), Operators.prolog())
    return read.term, [read.names.get(name) for name in ("K_", "T_", "L_")]


def filled(template, k, instant, later):
    """Return the term of a text with places for numbers."""
    term, names = _read(template)
    return copy(term, {name: value for name, value in zip(names, (k, instant, later)) if name is not None})


class Subject:
    """An engine with the program, and what has come out of it."""

    def __init__(self, limited=False):
        limits = Limits(seconds=600.0, inferences=1_000_000_000) if limited else Limits()
        self.limits = limits
        self.clock = StreamClock(SECOND)
        self.engine = Engine(self.clock, Settings(limits=limits))
        self.seen = []
        self.engine.load(RULES)
        self.engine.load(goals=GOALS)
        self.engine.call("nb_setval(open,closed)")
        self.engine.on_event(lambda *event: self.seen.append(event))
        self.engine.on_output(lambda *output: self.seen.append(output))
        self.engine.rules.on_error = lambda error: self.seen.append((atom("error"), error.message))
        self.engine.reports.error = lambda error, kind=None: self.seen.append((atom("error"), repr(error)))

    def event(self, text, instant):
        self.clock.move_to(instant * SECOND)
        self.engine.event(text, instant)

    def answers(self, goal, most=30):
        engine = self.engine
        try:
            return [
                {name: term_text(value) for name, value in found.items()}
                for found in engine.query(goal, most)
            ]
        except PrologError as error:
            return error.message

    def set_up(self, k, instant):
        """Have something wait that an action meets."""
        for at, text in enumerate(SETUP):
            self.event(filled(text, k, instant, instant + 50), instant + at)

    def act(self, text, k, instant):
        """Do an action."""
        kind, _, what = text.format(k=k, t=instant, later=instant + 50).partition(" ")
        if kind == "event":
            self.event(what, instant)
        elif kind == "call":
            self.engine.call(what)
        elif kind == "load":
            self.engine.load(rules=what)
        else:
            for _ in self.engine.query(what, 40):
                pass

    def probe(self, k, instant):
        """Return what follows from new events, and what new questions are answered."""
        del self.seen[:]
        for at, text in enumerate(PROBE):
            self.event(filled(text, k, instant + at, instant + 2), instant + at)
        self.event("end", instant + 30)  # all alarms ring
        seen = [(term_text(term), *rest) for term, *rest in self.seen]
        mine = [one for one in seen if f"({k}" in one[0] and not one[0].startswith("extra")]
        return mine + [self.answers(filled(goal, k, instant + 20, 0)) for goal in ANSWERS]
