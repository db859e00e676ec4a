"""``python3 -m retalis``."""

from .cli import main

raise SystemExit(main())
