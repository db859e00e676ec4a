"""The Prolog: terms, their text, the machine that runs goals, and what goals can call."""
