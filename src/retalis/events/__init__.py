"""Event processing: language, pattern network, memories and subscriptions."""
