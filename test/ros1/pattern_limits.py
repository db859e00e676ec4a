#!/usr/bin/env python3
"""Rules that multiply events, added to a running node by services: the node stops at its limit and answers others."""

import sys
import threading
import time
import unittest
from pathlib import Path

import rospy
import rostest
from rosgraph_msgs.msg import Log

sys.path.append(str(Path(__file__).resolve().parent))
from harness import Collector, wait_for_service, wait_until  # noqa: E402

from retalis import srv  # noqa: E402

RULES = 30
LIMIT = 2.0
"""Seconds, as in the launch file."""

ANSWER = 4 * LIMIT
"""Seconds in which a query is answered while an event is at its limit; a busy machine takes longer."""


class PatternLimits(unittest.TestCase):
    def test_rules_that_multiply_events_stop_at_the_limit(self):
        query = wait_for_service("retalis/query", srv.Query)
        add_rule = wait_for_service("retalis/add_rule", srv.AddRule)
        log = Collector("/rosout", Log)
        wait_until(log.is_connected, "the log")

        def ask(goal):
            return query(srv.QueryRequest(goal=goal))

        self.assertEqual(ask("set_etalis_flag(event_consumption_policy, unrestricted)").result, "ok")
        for number in range(RULES):
            rule = f"e{number + 1}(X) <- e{number}(X) and e{number}(Y)"
            self.assertEqual(add_rule(rule, f"multiply{number}").result, "ok")

        answers = []
        attacks = [
            threading.Thread(target=lambda value=value: answers.append(ask(f"event(e0({value}))").result))
            for value in (1, 2, 3)
        ]
        waits = []
        for attack in attacks:
            attack.start()
            begin = time.monotonic()
            self.assertEqual(ask("X = 1").result, "ok")
            waits.append(time.monotonic() - begin)
        for attack in attacks:
            attack.join(60)
        self.assertEqual(len(answers), len(attacks))
        self.assertLess(max(waits), ANSWER)
        self.assertEqual(ask("X = 1").solutions[0].bindings[0].text, "1")

        report = "has exceeded its limit of seconds while patterns were matched"
        messages = log.wait_for(
            lambda messages: any(report in one.msg for one in messages), "the report of the limit"
        )
        self.assertIn("multiply", next(one.msg for one in messages if report in one.msg))


if __name__ == "__main__":
    rospy.init_node("pattern_limits")
    rostest.rosrun("retalis", "pattern_limits", PatternLimits)
