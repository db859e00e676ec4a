#!/usr/bin/env python3
"""Rules that multiply events, added by services: the node ends them at its limit and answers other requests."""

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

RULE_COUNT = 30
LIMIT_SECONDS = 2.0
"""Limit in the launch file."""

MAX_ANSWER_SECONDS = 4 * LIMIT_SECONDS
"""Time to answer a query while an event reaches its limit; a busy machine takes longer."""


class PatternLimits(unittest.TestCase):
    def test_multiplying_rules_end_at_limit(self):
        query = wait_for_service("retalis/query", srv.Query)
        add_rule = wait_for_service("retalis/add_rule", srv.AddRule)
        log = Collector("/rosout", Log)
        wait_until(log.is_connected, "the log")

        def ask(goal):
            return query(srv.QueryRequest(goal=goal))

        self.assertEqual(ask("set_etalis_flag(event_consumption_policy, unrestricted)").result, "ok")
        for number in range(RULE_COUNT):
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
        self.assertLess(max(waits), MAX_ANSWER_SECONDS)
        self.assertEqual(ask("X = 1").solutions[0].bindings[0].text, "1")

        report = "has exceeded its limit of seconds while patterns were matched"
        records = log.wait_for(
            lambda records: any(report in record.msg for record in records), "the report of the limit"
        )
        self.assertIn("multiply", next(record.msg for record in records if report in record.msg))


if __name__ == "__main__":
    rospy.init_node("pattern_limits")
    rostest.rosrun("retalis", "pattern_limits", PatternLimits)
