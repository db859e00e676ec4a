"""Flags of the event language: values, defaults, and the network options that they determine."""

from math import inf
from typing import Callable, Dict, List, NamedTuple, Optional, Tuple

from ...foundation.errors import UsageError
from ...foundation.similar_names import did_you_mean
from ...prolog.terms.timestamps import from_seconds
from ...prolog.terms.types import Atom, Term, atom
from ..language.event_declarations import STRICTLY, UNDECLARED
from ..language.rule_labels import WATERMARK_DELAY
from ..matches.match_policies import ConsumptionPolicy, NetworkOptions
from ..matches.watermarks import DelaySetting, delay_setting
from ..streams.stream_operators import KeyBounds

_SWITCH = ("off", "on")


class Flag(NamedTuple):
    """A flag with its default and its values: names, or numbers if there is a description of these, or both.

    Attributes:
        values: permitted names.
        description: description of the permitted numbers for error messages.
        minimum: minimum of the numbers; the default may be less.
        is_integer: whether numbers must be integers.
    """

    default: Term
    values: Tuple[str, ...]
    description: str = ""
    minimum: float = 0
    is_integer: bool = False


def _switch_flag(default: str = "off") -> Flag:
    return Flag(atom(default), _SWITCH)


MAX_WATERMARK_DELAY = "max_watermark_delay"
"""Name of the flag that bounds delays of watermarks."""

_SECONDS = Flag(-1, (), "a number of seconds from 0, or -1 for none", 0)

# Programs that were written for ETALIS set its flags, so those without an effect here are accepted, too.
FLAGS: Dict[str, Flag] = {
    "event_consumption_policy": Flag(atom("recent"), tuple(policy.value for policy in ConsumptionPolicy)),
    "out_of_order": _switch_flag(),
    "revision_flag": _switch_flag(),
    "etalis_justification": _switch_flag(),
    "rule_sharing": _switch_flag(),
    "garbage_control": Flag(atom("off"), ("off", "general", "pattern")),
    "garbage_window": _SECONDS,
    "garbage_window_step": _SECONDS,
    "max_gap": _SECONDS,
    "state_ttl": _SECONDS,
    "max_keys": Flag(100_000, (), "a number of keys from 1", 1, True),
    "logging": _switch_flag(),
    "logging_to_file": _switch_flag(),
    "store_fired_events": _switch_flag(),
    "store_fired_events_java": _switch_flag(),
    "java_notification": _switch_flag(),
    "output_temporary_files": _switch_flag(),
    "prolog_backend": Flag(atom("swi"), ("swi",)),
    "db_trace": _switch_flag(),
    "subPatterns": _switch_flag("on"),
    "save_ruleId": _switch_flag(),
    WATERMARK_DELAY: Flag(atom("auto"), ("auto",), "auto or a number of seconds from 0"),
    MAX_WATERMARK_DELAY: Flag(1, (), "a number of seconds from 0"),
    UNDECLARED.name: Flag(atom("allowed"), ("allowed", STRICTLY.name)),
}


class Flags:
    """Values of all flags.

    Args:
        on_change: called with the name of a flag when its value has changed.
    """

    def __init__(self, on_change: Callable[[str], None]):
        self._on_change = on_change
        self._defaults: Dict[str, Term] = {name: flag.default for name, flag in FLAGS.items()}
        self._values = dict(self._defaults)
        self._callbacks: Dict[str, Callable[[float], None]] = {}

    def get(self, name: str) -> Optional[Term]:
        """Return the value of a flag, or None if the flag does not exist."""
        return self._values.get(name)

    def names(self) -> List[str]:
        """Return the names of all flags."""
        return list(FLAGS)

    def set(self, name: str, value: Term) -> None:
        """Set a flag.

        Raises:
            UsageError: if the flag does not exist or the value is invalid.
        """
        flag = FLAGS.get(name)
        if flag is None:
            raise UsageError(f"there is no flag {name}{did_you_mean(name, FLAGS)}")
        if value.__class__ is Atom and value.name in flag.values:
            pass
        elif not flag.description:
            raise UsageError(f"{name} takes {', '.join(flag.values)}")
        elif (
            not isinstance(value, (int, float))
            # NaN is neither in the range nor equal to the default.
            or not (flag.minimum <= value < inf or value == flag.default)
            or (flag.is_integer and value % 1)
        ):
            raise UsageError(f"{name} takes {flag.description}")
        if value != self._values[name]:
            self._values[name] = value
            self._on_change(name)
            if name in self._callbacks:
                self._callbacks[name](self.number(name))

    def set_default(self, name: str, value: Term) -> None:
        """Set a flag and make the value its default."""
        self.set(name, value)
        self._defaults[name] = value

    def on_numeric_change(self, name: str, callback: Callable[[float], None]) -> None:
        """Call a function with the value of a numeric flag at each change."""
        self._callbacks[name] = callback

    def changed_flags(self) -> Dict[str, Term]:
        """Return the flags whose values differ from their defaults."""
        return {name: value for name, value in self._values.items() if value != self._defaults[name]}

    def reset(self) -> None:
        """Reset all flags to their defaults."""
        for name, value in self._defaults.items():
            self.set(name, value)

    def is_on(self, name: str) -> bool:
        """Return whether a switch is on."""
        return self._values[name] is atom("on")

    def number(self, name: str) -> float:
        """Return the value of a numeric flag."""
        value = self._values[name]
        assert isinstance(value, (int, float))
        return value

    def watermark_delay(self) -> DelaySetting:
        """Return the delay of watermarks in ns for patterns without a property; None for ``auto``."""
        return delay_setting(self._values[WATERMARK_DELAY])

    def _atom_name(self, name: str) -> str:
        value = self._values[name]
        assert isinstance(value, Atom)
        return value.name

    def network_options(self) -> NetworkOptions:
        """Return the network options that the flags determine."""
        return NetworkOptions(
            ConsumptionPolicy(self._atom_name("event_consumption_policy")),
            self.is_on("out_of_order"),
            self.is_on("revision_flag") or self.is_on("etalis_justification"),
            self.is_on("revision_flag"),
        )

    def key_bounds(self) -> KeyBounds:
        """Return the limits for keyed state, for rules without properties."""
        ttl = self.number("state_ttl")
        return KeyBounds(None, from_seconds(ttl) if ttl > 0 else None, int(self.number("max_keys")))

    def garbage_control(self, properties: Dict[str, List[int]]) -> Optional[Tuple[int, int]]:
        """Return window and step in ns of the garbage control for a rule with the given properties, or None.

        A time to live acts as garbage control with that window and step 0: each event removes everything older.
        """
        ttl = self.key_bounds().max_idle_time
        # A property of the label overrides the flag; 0 turns the time to live off.
        if "ttl" in properties:
            ttl = min([time for time in properties["ttl"] if time], default=None)
        control = self._garbage_control(properties)
        return (ttl, 0) if ttl is not None and (control is None or ttl < control[0]) else control

    def _garbage_control(self, properties: Dict[str, List[int]]) -> Optional[Tuple[int, int]]:
        collection_mode = self.get("garbage_control")
        if collection_mode is atom("general"):
            window = self.number("garbage_window")
            if window > 0:
                return from_seconds(window), max(0, from_seconds(self.number("garbage_window_step")))
        elif collection_mode is atom("pattern") and "window" in properties and "window_step" in properties:
            return min(properties["window"]), min(properties["window_step"])
        return None
