"""Built-in predicates."""
