"""The six services: texts in, ``ok`` or ``error: ...`` out."""

from typing import Any, Callable, Dict, Iterator, List, NamedTuple, Tuple

import rospy

from ..engine import Engine, do_for_others
from ..events.language import subscribed_event
from ..events.program import topic_type
from ..foundation import RetalisError, SyntaxFault, UsageError, beginning, printable
from ..messages import Definitions
from ..prolog.syntax import Operators, ReadFlags, read_term
from ..prolog.terms import (
    COMMA,
    TRUE,
    Atom,
    CompoundTerm,
    Term,
    Var,
    atom,
    conjuncts,
    deref,
    functor,
    make_list,
    variables,
)
from .hints import published_types
from .interface import Interface
from .names import resolve
from .textonly import TextOnly

OK = "ok"

LONGEST_ANSWER = 1000
"""Characters of what a service says is wrong."""


MAX_REQUEST_CHARACTERS = 100_000
"""Characters of a request's fields together: the engine takes no events while they are read, for 0.5 to 1 s."""

_SUBSCRIBE = functor("subscribe", 5)


def shown(text: str) -> str:
    """Return the field of a request as answers show it."""
    return printable(beginning(text.strip()))


def provide(name: str, kind: Any, handler: Callable[[Any], Any]) -> None:
    """Provide a service whose requests have texts of a bounded length.

    Args:
        name: the service.
        kind: its class; the first field of its response is the result.
        handler: takes a request and returns its response.
    """

    def handle(request: Any) -> Any:
        size = sum(len(value) for value in _texts(request))
        if size > MAX_REQUEST_CHARACTERS:
            most = MAX_REQUEST_CHARACTERS
            return {"result": f"error: the request has {size} characters: expected at most {most}"}
        return handler(request)

    rospy.Service(name, kind, handle)


def _texts(request: Any) -> Iterator[str]:
    for field in request.__slots__:
        value = getattr(request, field)
        if isinstance(value, str):
            yield value
        elif isinstance(value, list):
            yield from value


def answer(work: Callable[[], None]) -> str:
    """Do a request; return ``ok``, or ``error: `` and the reason in one line with the position in the text."""
    try:
        work()
    except RetalisError as error:
        return reason(error)
    return OK


def reason(error: RetalisError) -> str:
    """Return an error as services answer it."""
    return "error: " + " ".join(
        beginning(error.brief(), LONGEST_ANSWER).splitlines()
    )  # names may have line breaks


class _Fields(NamedTuple):
    """What requests for a memory and for a subscription have in common.

    Attributes:
        event: the pattern of events.
        conditions: goals.
        form: what is made of an event; a variable for the event itself.
        free: the names in the format to which nothing gives a value.
    """

    event: Term
    conditions: List[Term]
    form: Term
    free: List[str]


class EngineServices:
    """The services of node retalis: subscriptions and memories.

    Args:
        engine: whose they are.
        text_only: is told of the topics that are subscribed.
        doubt: says why events of a pattern will hardly come, "" where they may.
        misfit: says why no output of a subscription, a goal ``subscribe/5``, can be a message of the type of its
            topic; "" if some may be.
    """

    def __init__(
        self,
        engine: Engine,
        text_only: TextOnly,
        doubt: Callable[[Term], str],
        misfit: Callable[[CompoundTerm, str], str],
    ):
        from retalis import srv  # noqa: PLC0415 - generated: there only where the package was built

        self._engine = engine
        self._text_only = text_only
        self._doubt = doubt
        self._misfit = misfit
        provide("add_output_subscription", srv.AddOutputSubscription, self._add_subscription)
        provide("delete_output_subscription", srv.DeleteOutputSubscription, self._delete_subscription)
        provide("add_memory", srv.AddMemory, self._add_memory)
        provide("delete_memory", srv.DeleteMemory, self._delete_memory)

    def _add_subscription(self, request: Any) -> str:
        def work() -> None:
            topic, key = name(request.topic, "topic"), name(request.id, "id")
            if self._engine.has_subscription(topic, key):
                raise UsageError(
                    f"a subscription {shown(request.id)} of topic {shown(request.topic)} already exists"
                )
            fields = self._fields(request)
            goal = (_SUBSCRIBE, fields.event, make_list(fields.conditions), fields.form, topic, key)
            misfit = self._misfit(goal, request.topic.strip())
            if misfit:
                raise UsageError(f"format: {misfit}")
            self._engine.add_subscription(fields.event, fields.conditions, fields.form, topic, key)
            self._warn_of_free("subscribe", request.id, fields)
            taken = fields._replace(event=subscribed_event(fields.event))
            self._warn_of_silence("subscribe", request.id, taken)
            self._text_only.look(request.topic.strip())

        return answer(lambda: do_for_others(self._engine, work))

    def _add_memory(self, request: Any) -> str:
        def work() -> None:
            key, size = name(request.id, "id"), self._size(request.size)
            if self._engine.has_memory(key):
                raise UsageError(f"a memory {shown(request.id)} already exists")
            fields = self._fields(request)
            self._engine.add_memory(fields.event, fields.conditions, fields.form, key, size)
            self._warn_of_free("memorize", request.id, fields)
            self._warn_of_silence("memorize", request.id, fields)

        return answer(lambda: do_for_others(self._engine, work))

    def _delete_subscription(self, request: Any) -> str:
        def work() -> None:
            topic, key = name(request.topic, "topic"), name(request.id, "id")
            if not self._engine.delete_subscription(topic, key):
                raise UsageError(
                    f"there is no subscription {shown(request.id)} of topic {shown(request.topic)}"
                )

        return answer(work)

    def _delete_memory(self, request: Any) -> str:
        def work() -> None:
            if not self._engine.delete_memory(name(request.id, "id")):
                raise UsageError(f"there is no memory {shown(request.id)}")

        return answer(work)

    def _fields(self, request: Any) -> _Fields:
        fields = {"event": request.event, "conditions": request.conditions.strip() or "true"}
        (event, conditions, form), names = self._read_together({**fields, "format": request.format})
        goals = [] if conditions is TRUE else list(conjuncts(conditions))
        self._check("event", "an event: an atom or a compound term", event, (Atom, tuple, Var))
        for one in goals:
            self._check("conditions", "goals: atoms or compound terms", one, (Atom, tuple))
        self._check("format", "an atom or a compound term, or _ for the event", form, (Atom, tuple, Var))
        unbound = set(variables(form)).difference(variables((COMMA, event, conditions)))
        free = [name for name, var in names.items() if var in unbound]
        return _Fields(event, goals, form, [] if isinstance(form, Var) else free)

    def _warn_of_free(self, goal: str, text: str, fields: _Fields) -> None:
        """Say where the format has variables that will never have a value."""
        if fields.free:
            rospy.logwarn(
                "%s %s: nothing in event or conditions gives %s in the format a value",
                goal,
                shown(text),
                " and ".join(fields.free),
            )

    def _warn_of_silence(self, goal: str, text: str, fields: _Fields) -> None:
        """Say where nothing makes the events that are waited for."""
        doubt = self._doubt(fields.event)
        if doubt:
            rospy.logwarn("%s %s: %s", goal, shown(text), printable(doubt))

    def _check(self, field: str, expected: str, term: Term, kinds: Tuple[type, ...]) -> None:
        if not isinstance(deref(term), kinds):
            raise UsageError(f"{field}: expected {expected}, found {self._engine.brief(term)}")

    def _read_together(self, fields: Dict[str, str]) -> Tuple[List[Term], Dict[str, Var]]:
        """Read fields each by itself, and have variables of one name be the same in all of them."""
        shared: Dict[str, Var] = {}
        terms: List[Term] = []
        for field, text in fields.items():
            if not text.strip():
                raise UsageError(f"{field} is empty")
            try:
                flags = ReadFlags(made=field == "format")
                read = read_term(text, self._engine.operators, field, flags)
            except SyntaxFault as fault:
                raise UsageError(f"{field}: {fault.brief()}") from fault
            for name, var in read.names.items():
                known = shared.setdefault(name, var)
                if known is not var:
                    var.ref = known
            terms.append(read.term)
        return terms, shared

    def _size(self, text: str) -> int:
        try:
            size = int(text)
        except ValueError:
            raise UsageError(f'size: expected a whole number, found "{beginning(text)}"') from None
        if size < 0:
            raise UsageError(f"size: expected a whole number of 0 or more, found {size}")
        return size


class InterfaceServices:
    """The services of the ROS interface: input subscriptions."""

    def __init__(self, interface: Interface):
        from retalis import srv  # noqa: PLC0415 - generated: there only where the package was built

        self._interface = interface
        provide("add_input_subscription", srv.AddInputSubscription, self._add)
        provide("delete_input_subscription", srv.DeleteInputSubscription, self._delete)

    def _add(self, request: Any) -> str:
        topic, kind = request.topic.strip(), request.message_type.strip()

        def work() -> None:
            topic_type(topic, kind)  # names that ROS does not allow are refused before any is looked up
            known = self._interface.outputs.knows(kind)
            meant = "" if known else Definitions().misspelt(kind)
            # A publisher brings the definition of its type, so that a type which is not installed is no mistake.
            if meant and not _is_published(topic, kind):
                raise UsageError(
                    f"message_type: there is no type '{shown(kind)}' here; did you mean {meant}? If a publisher is "
                    "to bring the type, start the publisher first"
                )
            self._interface.subscribe(topic, kind)
            if not known:
                rospy.logwarn(
                    "topic %s is subscribed as %s, which is not known here: it is learned from a publisher",
                    shown(topic),
                    kind,
                )

        return answer(work)

    def _delete(self, request: Any) -> str:
        return answer(lambda: self._interface.unsubscribe(request.topic.strip()))


def _is_published(topic: str, kind: str) -> bool:
    """Return whether somebody publishes a topic as a type, as far as the master knows."""
    return published_types().get(resolve(topic)) == kind


def name(text: str, field: str) -> Term:
    """Return the term of a topic or an id: what the text reads as if that is a constant, else the text's atom.

    A topic like ``robot/marker1`` reads as a division, but is meant as a name.
    """
    text = text.strip()
    if not text:
        raise UsageError(f"{field} is empty")
    try:
        term = read_term(text, Operators.prolog(), field).term
    except SyntaxFault:
        return atom(text)
    return term if isinstance(term, (Atom, int)) else atom(text)
