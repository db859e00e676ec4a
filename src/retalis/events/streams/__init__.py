"""Stream operators: windows, rate limits, absence and row patterns."""
