"""Pictures of programs and of runs."""
