"""Static checks of a loaded program."""
