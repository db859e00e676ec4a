"""Interrupt an engine at random, again and again, and compare what it answers with one that was left alone.

    python3 -m interrupts --number 10000 --seed 1 --way bytecode

An interrupt (or a limit that runs out) may leave undone what was to follow of the event or goal that was worked on.
What has to hold afterwards:

- nothing is left of the work: see ``checks``;
- what outlives events is in order: see ``checks``;
- new events and questions are answered exactly as by an engine that has not been interrupted: same events, stamps,
  order, outputs, answers, for values that do not occur in what was interrupted;
- a question that was interrupted changes nothing: asked again it has the same answers;
- of a text that was interrupted while it was loaded all is active, or nothing.
"""

import argparse
import gc
import logging
import random
import sys
import time
from collections import Counter
from difflib import ndiff

from retalis import RetalisError, functor

from .idle_engine_checks import faults
from .injection import AtBytecode, Interrupt, by_signal, looking_often, time_runs_out
from .program import ACTIONS, QUERIES, Subject

ROUNDS = 40
"""How often one engine is interrupted."""

WAYS = ("bytecode", "signal", "limit", "limited")


class Difference(AssertionError):
    """An engine that was interrupted is not as it has to be."""


class Reference:
    """What an engine answers that is never interrupted."""

    def __init__(self, limited):
        self._subject = Subject(limited)
        self._probes = []
        self._answers = {}

    def answers(self, goal):
        """Return the answers to a goal without effects."""
        if goal not in self._answers:
            self._answers[goal] = self._subject.answers(goal)
        return self._answers[goal]

    def probe(self, number):
        """Return what is answered in a round."""
        while len(self._probes) <= number:
            at = len(self._probes)
            self._subject.set_up(10 + 2 * at, 100 + 200 * at)
            self._probes.append(self._subject.probe(11 + 2 * at, 200 + 200 * at))
        return self._probes[number]


class Campaign:
    """A number of interrupts of one way."""

    def __init__(self, way, seed, like=None):
        self.way = way
        self.seed = seed
        self.random = random.Random(seed)
        self.outcomes = Counter()
        self._outcome = "done"
        self.steps = {} if like is None else like.steps
        self.times = {} if like is None else like.times
        self.reference = Reference(way in ("limit", "limited")) if like is None else like.reference

    def run(self, number):
        """Interrupt so often; raise a `Difference` at the first fault."""
        log = logging.getLogger("retalis")
        before = log.level
        log.setLevel(logging.CRITICAL)
        try:
            for done in range(0, number, ROUNDS):
                self._one_engine(min(ROUNDS, number - done))
        finally:
            log.setLevel(before)

    def _one_engine(self, rounds):
        subject = Subject(self.way in ("limit", "limited"))
        for number in range(rounds):
            queries = QUERIES if self.way == "limit" else QUERIES[:-1]
            action = self.random.choice((*ACTIONS, *(f"query {goal}" for goal in queries)))
            k, instant = 10 + 2 * number, 100 + 200 * number
            subject.set_up(k, instant)
            what = self._interrupt(subject, action, k, instant + 5)
            self.outcomes[self._outcome] += 1
            self._check(subject, action, number, what)

    def _check(self, subject, action, number, what):
        k, instant = 11 + 2 * number, 200 + 200 * number
        found = faults(subject.engine)
        if not found and action.startswith("query") and "repeat" not in action:
            goal = action.partition(" ")[2]
            mine, other = subject.answers(goal), self.reference.answers(goal)
            found = [] if mine == other else [f"asked again: {mine} and not {other}"]
        if not found and action.startswith("load"):
            found = self._of_load(subject, action, k - 1)
        if not found:
            mine, other = subject.probe(k, instant), self.reference.probe(number)
            found = [line for line in ndiff([*map(str, other)], [*map(str, mine)]) if line[0] in "+-"]
            found += faults(subject.engine)
        if found:
            raise Difference(f"seed {self.seed}: {action} (number {k - 1}), {what}:\n  " + "\n  ".join(found))

    @staticmethod
    def _of_load(subject, action, k):
        names = [rule.name for rule in subject.engine.rules.rules if f"extra{k}(" in rule.name]
        first = "extra{k}_" if "extra{k}_" in action else "loaded{k}"
        predicate = subject.engine.logic.lookup(functor(first.format(k=k), 1))
        clauses = 0 if predicate is None else len(predicate)
        return [] if (len(names), clauses) in ((0, 0), (1, 2)) else [f"loaded by half: {names} {clauses}"]

    def _interrupt(self, subject, action, k, instant):
        """Do an action and interrupt it at random; return where."""
        way = getattr(self, f"_by_{self.way}")
        return way(subject, action, k, instant)

    def _do(self, subject, action, k, instant):
        outcome = "done"
        try:
            subject.act(action, k, instant)
        except Interrupt:
            outcome = "interrupted"
        except RetalisError:
            outcome = "ended with an error"
        finally:
            self._outcome = outcome

    def _by_bytecode(self, subject, action, k, instant):
        most = self.steps.get(action)
        if most is None:
            trial = Subject()
            trial.set_up(k, instant - 5)
            with AtBytecode() as counted:
                trial.act(action, k, instant)
            most = self.steps[action] = counted.number
        with AtBytecode(self.random.randrange(1, most + 1)) as at:
            self._do(subject, action, k, instant)
        if at.where is None:
            self.steps[action] = at.number  # it gets faster when it has been compiled
        return f"bytecode {at.at} of {most}: {at.where}"

    _by_limited = _by_bytecode

    def _by_signal(self, subject, action, k, instant):
        most = self.times.get(action)
        if most is None:
            trial = Subject()
            trial.set_up(k, instant - 5)
            began = time.perf_counter()
            trial.act(action, k, instant)
            most = self.times[action] = time.perf_counter() - began
        delay = self.random.uniform(0, most)
        began = time.perf_counter()
        try:
            with by_signal(delay):
                self._do(subject, action, k, instant)
        except Interrupt:  # just behind the action
            pass
        if self._outcome == "done":
            self.times[action] = min(most, time.perf_counter() - began)
        return f"a signal after {delay * 1e6:.0f} us of {most * 1e6:.0f}"

    def _by_limit(self, subject, action, k, instant):
        most = 200 if "repeat" in action else self.steps.get(action)
        if most is None:
            trial = Subject(True)
            trial.set_up(k, instant - 5)
            with looking_often(), time_runs_out(trial.engine, None) as looks:
                trial.act(action, k, instant)
            most = self.steps[action] = max(1, looks[0])
        at = self.random.randrange(1, most + 1)
        with looking_often(), time_runs_out(subject.engine, at):
            self._do(subject, action, k, instant)
        return f"no more time at look {at} of {most}"


def main():
    """Interrupt as often as the command line says."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--number", type=int, default=1000)
    parser.add_argument("--seed", type=int, default=1)
    parser.add_argument("--way", choices=WAYS, default="bytecode")
    parser.add_argument(
        "--keep-going", action="store_true", help="count faults, and go on with other engines"
    )
    options = parser.parse_args()
    faulty, done, seed = 0, 0, options.seed
    outcomes, campaign = Counter(), None
    while done < options.number:
        number = min(ROUNDS, options.number - done) if options.keep_going else options.number
        campaign = Campaign(options.way, seed, campaign)
        try:
            campaign.run(number)
        except Difference as difference:
            faulty += 1
            print(difference, flush=True)
            if not options.keep_going:
                return 1
        outcomes += campaign.outcomes
        done, seed = done + number, seed + 1
        gc.collect()
    seeds = f"seeds {options.seed} to {seed - 1}"
    print(f"{options.way}: {seeds}, {sum(outcomes.values())} times, {dict(outcomes)}; {faulty} faults")
    return 1 if faulty else 0


if __name__ == "__main__":
    sys.exit(main())
