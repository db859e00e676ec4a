"""Clock, executor, watchdog and problem reports of an engine."""
