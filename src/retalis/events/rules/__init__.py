"""Event rules, flags and timers of a running program, and their predicates."""
