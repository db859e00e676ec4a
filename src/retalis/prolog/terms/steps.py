"""How far walks over terms go."""

from ...foundation import BULK, TermTooLarge, look

MOST = 5_000_000
"""Steps after which walking a term is given up."""

ROUNDS = range(MOST // len(BULK))
"""Rounds of `BULK` steps in a walk; after each there is a look at the limits of the goal that walks."""

MASK = len(BULK) - 1
"""Steps at which this is zero end a round."""


def check_steps(steps: int) -> None:
    """Look at the limits of the goal that walks; give up a walk of too many steps."""
    look()
    if steps > MOST:
        raise TermTooLarge
