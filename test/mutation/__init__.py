"""Mutation testing: changes one place of the source at a time and counts the changes that no test notices."""
