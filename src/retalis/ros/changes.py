"""The services that change rules: ``~add_rule`` and ``~delete_rule``."""

from typing import Any

from ..engine import Engine, add_rule, delete_rule
from ..foundation import ProgramErrors, RetalisError, SyntaxFault, beginning
from .services import LONGEST_ANSWER, OK, answer, provide, reason


class RuleServices:
    """Services ``~add_rule`` and ``~delete_rule`` of node retalis.

    Args:
        engine: whose rules they change.
    """

    def __init__(self, engine: Engine):
        from retalis import srv  # noqa: PLC0415 - generated: there only where the package was built

        self._engine = engine
        self._added = srv.AddRuleResponse
        provide("~add_rule", srv.AddRule, self._add)
        provide("~delete_rule", srv.DeleteRule, self._delete)

    def _add(self, request: Any) -> Any:
        try:
            return self._added(OK, add_rule(self._engine, request.rule, request.label))
        except (SyntaxFault, ProgramErrors) as error:
            return self._added(
                f"error: {beginning(str(error), LONGEST_ANSWER)}", ""
            )  # with the lines and carets
        except RetalisError as error:
            return self._added(reason(error), "")

    def _delete(self, request: Any) -> str:
        return answer(lambda: delete_rule(self._engine, request.label))
