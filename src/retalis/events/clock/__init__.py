"""Clocks, alarms, and checks of timestamps ahead of a clock."""
