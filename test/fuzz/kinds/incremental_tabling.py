"""Incremental tables and the same program without tables: random changes, and the same answers."""

import json
from typing import Any, Iterator

from retalis import Limits, RetalisError, Settings

from ..mutate import to_bytes, to_text
from ..side_effects import FindingError
from .base import LOGGED, Kind, create_silent_engine

SETTINGS = Settings(limits=Limits(seconds=2.0, inferences=300_000, megabytes=40), folders=())

BASE = ("e/2", "n/1", "s/1")
DYNAMIC = ":- dynamic e/2 as incremental.\n:- dynamic([n/1, s/1], [incremental(true)]).\n"
FACTS = "e(1, 2). e(2, 3). n(1). n(2). n(3). s(1).\n"
MEMORY = "memorize(pose(X), [], X, m, 4)\nmemorize(seen(X), [], X, k, 100)"
NEGATION = r"\+ {}"
FORMS = ("{}", "{}", "{}", NEGATION, "once({})", "forall({}, true)", "catch({}, _, fail)", "call({})")
CONSTANTS = (1, 2, 3, 4, 5)
MODES = ("min", "max")


class Inputs(Kind):
    """An input is a JSON object: rules with and without tables, operations, and the goals to compare."""

    block_size = 20

    def setup(self) -> None:
        create_silent_engine().load(DYNAMIC + FACTS)  # reads the library

    def generate(self, rng: Any) -> bytes:
        names, tabled, plain = ["n", "s", "up"], [], []
        for number in range(rng.choice((1, 2, 3, 4))):
            name = f"p{number}"
            for rule in self.rules(rng, name, names):
                tabled.append(rule[0])
                plain.append(rule[1])
            if rng.random() < 0.85:
                names.append(name)
        declared = [name for name in names[3:] if rng.random() < 0.9] + ["r"]
        heads = ", ".join(f"{name}/{2 if name == 'r' else 1}" for name in declared)
        # The table that calls a predicate without a table reads its clauses.
        start = (
            f":- table ({heads}) as incremental.\n"
            if ", " in heads
            else f":- table {heads} as incremental.\n"
        )
        operations = [self.operation(rng, names) for _ in range(rng.randint(3, 14))]
        record = {
            "tabled": start + "".join(tabled) + "r(X, Y) :- e(X, Y).\nr(X, Y) :- r(X, Z), e(Z, Y).\n",
            "plain": "".join(plain) + "r(X, Y) :- e(X, Y).\nr(X, Y) :- e(X, Z), r(Z, Y).\n",
            "operations": operations,
            "goals": [*(f"{name}(X)" for name in names), "r(1, X)", "r(X, 3)", "r(A, B), X = A-B"],
        }
        return to_bytes(json.dumps(record))

    def rules(self, rng: Any, name: Any, names: Any) -> Iterator[Any]:
        """Return clauses of a predicate over those before it, for both programs."""
        for _ in range(rng.choice((1, 1, 2))):
            bound = rng.choice(
                ("n(X)", "e(X, _)", "e(_, X)", "r(_, X)", "memory_value(X)", f"{rng.choice(names)}(X)")
            )
            body = [bound]
            for _ in range(rng.choice((0, 1, 2))):
                body.append(rng.choice(FORMS).format(self.literal(rng, names)))
            if rng.random() < 0.2:
                body = [f"findall(Y, ({', '.join(body).replace('X', 'Y')}), L), sort(L, S), length(S, X)"]
            yield (f"{name}(X) :- {', '.join(body)}.\n",) * 2

    def literal(self, rng: Any, names: Any) -> Any:
        return rng.choice(
            (
                f"{rng.choice(names)}(X)",
                "e(X, _)",
                "r(X, _)",
                f"r({rng.choice(CONSTANTS)}, X)",
                f"clause({rng.choice('ns')}(X), true)",
                "newest_matching(m, X, _, _)",
                "holds(h(X))",
            )
        )

    def operation(self, rng: Any, names: Any) -> Any:
        """Return a goal, or an event after a mark."""
        draw = rng.random()
        # Edges lead upwards, so that programs without tables end.
        low, high = sorted(rng.sample(CONSTANTS, 2))
        fact = rng.choice((f"e({low}, {high})", f"n({low})", f"s({high})"))
        if draw < 0.35:
            return f"{rng.choice(('assertz', 'asserta'))}({fact})"
        if draw < 0.6:
            return f"ignore(retract({fact}))"
        if draw < 0.65:
            return rng.choice(("retractall(e(_, _))", "retractall(n(_))", f"retractall(e({low}, _))"))
        if draw < 0.7:
            return "assertz((n(X) :- s(X)))"
        if draw < 0.8:
            return f"event {rng.choice(('pose', 'seen', 'a', 'b'))}({rng.choice(CONSTANTS)})"
        name = rng.choice(names)
        if draw < 0.84:  # an error while the answers of a table are read
            return f"{name}(_), atom_length(_, _)"
        if draw < 0.9:  # a table that is not read to its end, or changes while it is read
            return f"ignore((once({name}(X)), assertz(s(X))))"
        if draw < 0.95:
            return f"forall({name}(X), assertz(n(X)))"
        return f"catch(({name}(_), throw(a)), _, true), ignore(retract({fact}))"

    def run(self, data: Any) -> None:
        try:
            record = json.loads(to_text(data))
            tabled, plain = (DYNAMIC + FACTS + record[name] + HELPERS for name in ("tabled", "plain"))
            operations, goals = record["operations"], record["goals"]
        except (ValueError, KeyError, TypeError):  # an input that was shortened too far
            return
        engines = [create_silent_engine(SETTINGS), create_silent_engine(SETTINGS)]
        for engine, text in zip(engines, (tabled, plain)):
            if self.attempt(lambda engine=engine, text=text: engine.load(text, MEMORY) or True) is None:
                return
        for now, operation in enumerate(["true", *operations], 1):
            for engine in engines:
                if operation.startswith("event "):
                    self.attempt(engine.event, operation[6:], now)
                else:
                    self.attempt(engine.query, operation, 1)
            for goal in goals:
                tabled_answers, plain_answers = (self.answers(engine, goal) for engine in engines)
                if tabled_answers != plain_answers:
                    raise FindingError(
                        "difference",
                        f"{goal} after {operation}: {tabled_answers} with tables, {plain_answers} without",
                        "tables",
                    )
        LOGGED.check()

    def answers(self, engine: Any, goal: Any) -> Any:
        """Return the set of answers, or the kind of the error."""
        try:
            answers = sorted({engine.show(solution["X"]) for solution in engine.query(goal, 200)})
        except RetalisError as error:
            self.refused_count += 1
            return f"error {error.brief()}"[:60]
        self.accepted_count += 1
        return answers


HELPERS = """
up(X) :- s(Y), X is Y + 1.
memory_value(X) :- newest_matching(m, X, _, _).
memory_value(X) :- newest_matching(k, X, _, _).
:- state(h(X), from(a(X)), until(b(X))).
"""
