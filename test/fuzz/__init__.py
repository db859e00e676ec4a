"""Random and mutated inputs for all interfaces of the package that accept input; see README.md."""
