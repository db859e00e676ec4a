"""``python3 -m retalis``."""

try:
    from .cli import main
except ModuleNotFoundError as missing:
    if missing.name != "lark":
        raise
    raise SystemExit("retalis: the Python package lark is missing: pip install lark") from None

raise SystemExit(main())
