"""What programs know: memory instances, queries that wait for them, subscriptions, and states.

Each is fed by the dispatcher (`retalis.events.dispatch`) and reached by goals (`retalis.prolog.logic`); `Knowledge`
puts them together.
"""

from .knowledge import DELETE_MEMORY, MEMORIZE, OF_MEMORIES, OWN_EVENTS, SUBSCRIBE, Knowledge
from .memory import NEVER
from .recorder import Instance
from .recording import is_whole
from .states import DeclaredState
from .subscriptions import Key as SubscriptionKey
from .subscriptions import Subscription
from .timeouts import TimeoutAlarm

__all__ = [
    "DeclaredState",
    "DELETE_MEMORY",
    "Instance",
    "is_whole",
    "Knowledge",
    "MEMORIZE",
    "NEVER",
    "OF_MEMORIES",
    "OWN_EVENTS",
    "SUBSCRIBE",
    "Subscription",
    "SubscriptionKey",
    "TimeoutAlarm",
]
