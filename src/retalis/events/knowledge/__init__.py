"""Memories, synchronized queries, subscriptions and states of a program."""
