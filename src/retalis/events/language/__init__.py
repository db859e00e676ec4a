"""Event language: syntax trees, parsers and static checks of event rules."""
