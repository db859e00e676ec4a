"""The event language: parsing and checking of rules."""
