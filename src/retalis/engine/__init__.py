"""The engine: loads a program, processes events, and reports its state."""
