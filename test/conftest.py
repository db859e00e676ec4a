"""What all tests share: hypothesis tries the same examples in every run, so that a failure can be repeated, and
takes its time: a machine may be busy.

The commands for long runs (``test/oracle``, ``test/fuzz``) take seeds and try others.
"""

try:
    from hypothesis import settings
except ImportError:  # the tests that need it are skipped, or say so themselves
    pass
else:
    settings.register_profile("repeatable", derandomize=True, deadline=None)
    settings.load_profile("repeatable")
