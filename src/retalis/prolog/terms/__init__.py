"""Terms: types, unification, order and traversal."""
