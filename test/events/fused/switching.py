"""A plugin of pytest that switches fused paths off: ``-p events.fused.switching --without-fused goals sides``.

Everything is then served by the plain way. Tests marked ``fused`` are about the fused paths themselves.
"""

from retalis.events.dispatch import Dispatcher, audience, gates
from retalis.events.knowledge import waiting
from retalis.events.network import conditions, joining, streaming


def plain_action(plain):
    """Return an action that serves any event by the plain way, also one that comes without values."""
    return lambda term, values, *rest: plain(term, term[1:] if values is None else values, *rest)


def without_fused_incoming():
    listen = Dispatcher.listen
    Dispatcher.listen = lambda self, stage, pattern, action, rank=(), fused=None, **rest: listen(
        self, stage, pattern, action, rank, None, **rest
    )


def without_gates():
    class OpenGate(gates.Gate):
        """A gate whose plan is never known, so that it lets everything pass."""

        __slots__ = ()
        plan = property(lambda gate: None, lambda gate, plan: None)

    audience.Gate = OpenGate


def without_goals():
    conditions.goal_action = lambda goal, inputs, rule, failed, plain, completion: plain_action(plain)


def without_questions():
    waiting.question_action = lambda *arguments: None


def without_sides():
    joining.fused_side = lambda side, pair, taking, rule, plain, emit: (plain_action(plain), None)


def without_absences():
    joining.fused_absence = lambda absence, rule, whole, plain: (plain_action(plain), None)


def without_windows():
    streaming.fused_window = lambda form, span, node, plain, complete, too_large: plain


PATHS = {
    "incoming": without_fused_incoming,
    "gates": without_gates,
    "goals": without_goals,
    "questions": without_questions,
    "sides": without_sides,
    "absences": without_absences,
    "windows": without_windows,
}


def pytest_addoption(parser):
    parser.addoption("--without-fused", nargs="+", choices=[*PATHS], default=[], metavar="PATH")


def pytest_configure(config):
    for path in config.getoption("--without-fused"):
        PATHS[path]()
