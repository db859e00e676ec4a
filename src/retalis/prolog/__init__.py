"""The Prolog system."""
