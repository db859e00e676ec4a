#!/usr/bin/env python3
"""The six services with valid and invalid requests, while events are processed."""

import sys
import tempfile
import threading
import time
import unittest
from pathlib import Path

import rospy
import rostest
from rosgraph_msgs.msg import Log
from std_msgs.msg import Float64, String

sys.path.append(str(Path(__file__).resolve().parent))
from harness import TIMEOUT_SECONDS, Collector, wait_for_message_path, wait_for_service, wait_until  # noqa: E402

from retalis import srv  # noqa: E402


class Services(unittest.TestCase):
    @classmethod
    def setUpClass(cls):
        wait_for_message_path()
        cls.add_subscription = staticmethod(
            wait_for_service("add_output_subscription", srv.AddOutputSubscription)
        )
        cls.delete_subscription = staticmethod(
            wait_for_service("delete_output_subscription", srv.DeleteOutputSubscription)
        )
        cls.add_memory = staticmethod(wait_for_service("add_memory", srv.AddMemory))
        cls.delete_memory = staticmethod(wait_for_service("delete_memory", srv.DeleteMemory))
        cls.add_input = staticmethod(wait_for_service("add_input_subscription", srv.AddInputSubscription))
        cls.delete_input = staticmethod(
            wait_for_service("delete_input_subscription", srv.DeleteInputSubscription)
        )
        cls.outputs = Collector("retalisOutputEvents", String)
        cls.events = rospy.Publisher("retalisInputEvents", String, queue_size=5000)
        wait_until(
            lambda: cls.events.get_num_connections() > 0 and cls.outputs.is_connected(), "node retalis"
        )
        cls.flowing = threading.Event()
        cls.flowing.set()
        cls.flow = threading.Thread(target=cls.keep_flowing, daemon=True)
        cls.flow.start()

    @classmethod
    def tearDownClass(cls):
        cls.flowing.clear()
        cls.flow.join(10)

    @classmethod
    def keep_flowing(cls):
        """Publish events continuously, so that services are answered by a busy node."""
        number = 0
        while cls.flowing.is_set() and not rospy.is_shutdown():
            number += 1
            cls.events.publish(String(f"event(flow({number}))"))
            time.sleep(0.002)

    def send(self, *texts):
        for text in texts:
            self.events.publish(String(text))

    def wait_for_output(self, text):
        self.outputs.wait_for(lambda messages: any(message.data == text for message in messages), text)

    def has_output(self, text):
        return any(message.data == text for message in self.outputs.messages)

    def assert_error(self, response, *parts):
        self.assertTrue(response.result.startswith("error: "), response.result)
        self.assertNotIn("\n", response.result)
        for part in parts:
            self.assertIn(part, response.result)

    def test_subscription_is_added_and_deleted(self):
        self.assertEqual(
            self.add_subscription("a(X)", "X > 1, X < 9", "got(X)", "somewhere", "s1").result, "ok"
        )
        self.send("event(a(1))", "event(a(5))", "event(a(10))", "event(a(6))")
        self.wait_for_output("event(got(6),somewhere,s1)")
        self.assertTrue(self.has_output("event(got(5),somewhere,s1)"))
        self.assertFalse(self.has_output("event(got(1),somewhere,s1)"))
        self.assertFalse(self.has_output("event(got(10),somewhere,s1)"))
        self.assertEqual(self.delete_subscription("somewhere", "s1").result, "ok")
        self.assertEqual(self.add_subscription("a(X)", "", "_", "somewhere", "s2").result, "ok")
        self.send("event(a(7))")
        self.wait_for_output("event(a(7),somewhere,s2)")
        self.assertFalse(self.has_output("event(got(7),somewhere,s1)"))
        self.assertEqual(self.delete_subscription("somewhere", "s2").result, "ok")

    def test_full_stop_and_comments_are_accepted(self):
        added = self.add_subscription("c(X).", "X > 1 % large", "_.", "t", "stop")
        self.assertEqual(added.result, "ok")
        self.send("event(c(1))", "event(c(2))")
        self.wait_for_output("event(c(2),t,stop)")
        self.assertFalse(self.has_output("event(c(1),t,stop)"))
        self.assertEqual(self.delete_subscription("t", "stop").result, "ok")

    def test_topics_may_have_slashes(self):
        self.assertEqual(self.add_subscription("slash(X)", "", "_", "/robot/out", "1").result, "ok")
        self.send("event(slash(1))")
        self.wait_for_output("event(slash(1),'/robot/out',1)")
        self.assertEqual(self.delete_subscription("/robot/out", "1").result, "ok")

    def test_repeated_subscription_is_an_error(self):
        self.assertEqual(self.add_subscription("b(_)", "", "_", "t", "twice").result, "ok")
        self.assert_error(
            self.add_subscription("b(_)", "", "_", "t", "twice"), "subscription twice of topic t already"
        )
        self.assertEqual(self.add_subscription("b(_)", "", "_", "other", "twice").result, "ok")
        self.assertEqual(self.delete_subscription("t", "twice").result, "ok")
        self.assertEqual(self.delete_subscription("other", "twice").result, "ok")

    def test_invalid_topic_is_an_error(self):
        for topic in ("bad topic!", "4x4", "a//b", "über"):
            with self.subTest(topic):
                self.assert_error(
                    self.add_subscription("a(X)", "", "_", topic, "never"), "topic: expected a topic"
                )
                self.assert_error(self.delete_subscription(topic, "never"), "there is no subscription never")

    def test_unknown_subscription_is_an_error(self):
        self.assert_error(self.delete_subscription("t", "never"), "never")
        self.assert_error(self.delete_subscription("t", "two\nlines"), "two lines")

    def test_error_has_field_and_position(self):
        self.assert_error(self.add_subscription("a(X", "", "_", "t", "e1"), "event", "column")
        self.assert_error(self.add_subscription("a(X)", "X >", "_", "t", "e1"), "conditions", "column")
        self.assert_error(self.add_subscription("a(X)", "", "f(]", "t", "e1"), "format", "line 1, column 3")
        self.assert_error(self.add_subscription("a(X)", "X > 1, X >", "_", "t", "e1"), "line 1, column 11")
        self.assert_error(self.add_subscription("", "", "_", "t", "e1"), "event")
        self.assert_error(
            self.add_subscription("3", "", "_", "t", "e1"), "event: expected an event", "found 3"
        )
        self.assert_error(self.add_subscription("a(X)", "X", "_", "t", "e1"), "conditions: expected goals")
        self.assert_error(self.add_subscription("a(X)", "", "7", "t", "e1"), "format: expected", "found 7")
        self.assert_error(self.add_subscription("a),b(X)", "", "_", "t", "e1"), "event")
        self.assert_error(self.add_subscription("a),(b", "", "_", "t", "e1"), "event", "column 2")
        self.assert_error(self.delete_subscription("t", "e1"), "e1")

    def test_memory_is_added_and_deleted(self):
        self.assertEqual(self.add_memory("v(X)", "", "kept(X)", "m", "2").result, "ok")
        self.assert_error(self.add_memory("v(X)", "", "_", "m", "2"), "m")
        added = self.add_subscription("ask", "findall(X, access_mem(m, kept(X), _), L)", "all(L)", "t", "ask")
        self.assertEqual(added.result, "ok")
        self.send(*(f"event(v({i}))" for i in (1, 2, 3)), "event(ask)")
        self.wait_for_output("event(all([3,2]),t,ask)")
        self.assertEqual(self.delete_memory("m").result, "ok")
        self.assert_error(self.delete_memory("m"), "m")
        self.assertEqual(self.delete_subscription("t", "ask").result, "ok")

    def test_invalid_memory_is_not_added(self):
        self.assert_error(self.add_memory("v(X)", "", "_", "bad", "many"), "size", "many")
        self.assert_error(self.add_memory("v(X)", "", "_", "bad", "-1"), "size: expected", "found -1")
        self.assert_error(
            self.add_memory("v(X)", "", "_", "bad", "0"), "size: expected", "from 1 to 1000000, found 0"
        )
        for size in ("1000001", "9" * 24):
            self.assert_error(self.add_memory("v(X)", "", "_", "bad", size), "to 1000000, found " + size)
        self.assert_error(
            self.add_memory("v(X)", "1", "_", "bad", "5"), "conditions: expected goals", "found 1"
        )
        self.assert_error(self.add_memory("v(X)", "", "_", "", "5"), "id")
        self.assert_error(self.delete_memory("bad"), "bad")

    def test_repeated_memory_is_an_error(self):
        self.assertEqual(self.add_memory("w(X)", "", "_", "twice", "5").result, "ok")
        response = self.add_memory("w(X)", "", "_", "twice", "5")
        self.assertEqual(response.result, "error: a memory twice already exists")
        self.assertEqual(self.delete_memory("twice").result, "ok")

    def test_topic_without_type_is_warned_of(self):
        log = Collector("/rosout", Log)
        wait_until(lambda: "/retalis" in log.publishers(), "the log")
        self.assertEqual(self.add_subscription("u(_)", "", "_", "nothing/there", "u").result, "ok")
        log.wait_for(
            lambda messages: any("topic nothing/there has no type" in m.msg for m in messages), "the warning"
        )
        self.assertEqual(self.delete_subscription("nothing/there", "u").result, "ok")

    def test_memory_without_records_is_warned_of(self):
        log = Collector("/rosout", Log)
        wait_until(lambda: "/retalis" in log.publishers(), "the log")
        self.assertEqual(self.add_memory("v(X)", "no_such(X)", "kept(Y)", "odd", "2").result, "ok")
        for text in ("memory odd: there is no predicate no_such/1 yet", "gives Y in the format a value"):
            log.wait_for(lambda records, text=text: any(text in record.msg for record in records), text)
        self.assertEqual(self.delete_memory("odd").result, "ok")

    def test_input_subscription_is_added_and_deleted(self):
        number = rospy.Publisher("number", Float64, queue_size=10)
        self.assertEqual(self.add_input("number", "std_msgs/msg/Float64").result, "ok")
        self.assert_error(self.add_input("number", "std_msgs/Float64"), "number")
        self.assertEqual(
            self.add_subscription("std_msgs__0__Float64(X)", "", "number(X)", "t", "n").result, "ok"
        )
        deadline = time.monotonic() + TIMEOUT_SECONDS
        while not self.has_output("event(number(2.5),t,n)"):
            self.assertLess(time.monotonic(), deadline, "no number is received")
            number.publish(2.5)
            time.sleep(0.01)
        self.assertEqual(self.delete_input("number").result, "ok")
        self.assert_error(self.delete_input("number"), "number")
        self.assert_error(self.add_input("number", "Float64"), "package/Type")
        self.assert_error(self.add_input("a b", "std_msgs/Float64"), "a b")
        self.assert_error(self.add_input("a?b", "std_msgs/Float64"), "a?b")
        self.assert_error(self.add_input("tf", "tf/tfMessage"), "tf")  # a direct topic of node retalis
        self.assert_error(self.add_input("", "std_msgs/Float64"))
        self.assertEqual(self.delete_subscription("t", "n").result, "ok")

    def test_format_unlike_type_of_topic_is_an_error(self):
        for form, reason in (
            ("got(X)", "expected geometry_msgs__0__PoseStamped/2, got got/1"),
            ("_", "expected geometry_msgs__0__PoseStamped/2, got p/1"),
            ("geometry_msgs__0__PoseStamped(X, here)", "slot pose: expected geometry_msgs__0__Pose/2"),
        ):
            for topic in ("marker1", "/marker1"):
                added = self.add_subscription("p(X)", "", form, topic, "never")
                self.assert_error(added, f"format: topic {topic}, geometry_msgs/PoseStamped", reason)
                self.assert_error(self.delete_subscription(topic, "never"), "there is no subscription never")
        self.assertEqual(self.add_subscription("p(X)", "", "X", "marker1", "may").result, "ok")
        self.assertEqual(self.delete_subscription("marker1", "may").result, "ok")

    def test_misspelt_type_has_similar_name(self):
        self.assert_error(
            self.add_input("speed", "std_msgs/Flaot64"),
            "there is no type 'std_msgs/Flaot64' here; did you mean std_msgs/Float64?",
        )
        self.assert_error(self.add_input("speed", "std_msg/Float64"), "did you mean std_msgs/Float64?")
        self.assert_error(self.delete_input("speed"), "speed")
        # Types without similar names, and types of publishers, are accepted.
        self.assertEqual(self.add_input("speed", "far_msgs/Unknown").result, "ok")
        self.assertEqual(self.delete_input("speed").result, "ok")
        members = {"_type": "std_msgs/Flaot64", "_md5sum": "0" * 32, "_full_text": "int32 x\n"}
        publisher = rospy.Publisher(
            "speed", type("Brought", (rospy.AnyMsg,), {**members, "__slots__": ["_buff"]}), queue_size=1
        )
        self.assertEqual(self.add_input("speed", "std_msgs/Flaot64").result, "ok")
        self.assertEqual(self.delete_input("speed").result, "ok")
        publisher.unregister()

    def test_goal_subscribes_topic_of_running_node(self):
        publisher = rospy.Publisher("asked", Float64, queue_size=10)
        query = wait_for_service("retalis/query", srv.Query)
        goal = "subscribe_to(asked, 'std_msgs/Float64', asked_number)"
        for _ in range(2):
            self.assertEqual(query(goal=goal).result, "ok")
        self.assertIn("subscribed already", query(goal="subscribe_to(asked, 'std_msgs/Int8')").result)
        self.assertEqual(self.add_subscription("asked_number(X)", "", "asked(X)", "t", "q").result, "ok")
        deadline = time.monotonic() + TIMEOUT_SECONDS
        while not self.has_output("event(asked(2.5),t,q)"):
            self.assertLess(time.monotonic(), deadline, "no number is received")
            publisher.publish(2.5)
            time.sleep(0.01)
        self.assert_error(self.add_input("asked", "std_msgs/Float64"), "asked")
        self.assertEqual(self.delete_input("asked").result, "ok")
        self.assertEqual(self.delete_subscription("t", "q").result, "ok")

    def test_names_of_types_are_not_executed(self):
        created_file = Path(tempfile.mkdtemp()) / "harm"
        log = Collector("/rosout", Log)
        wait_until(lambda: "/retalis" in log.publishers(), "the log")
        for type_name in (
            f'a/b:=__import__("os").system("touch {created_file}")',
            f"a/b(__import__('os').system('touch {created_file}'))",
            f'a/b",__import__("os").system("touch {created_file}"),"',
        ):
            self.assert_error(self.add_input("hostile", type_name), "expected a message type")
            members = {"_type": "a/B", "_md5sum": "0" * 32, "_full_text": "int32 x\n", "__slots__": ["_buff"]}
            hostile = type("Hostile", (rospy.AnyMsg,), members)
            publisher = rospy.Publisher("hostile", hostile, queue_size=10)
            hostile._type = type_name  # the master checks the type, connections may state any
            self.assertEqual(self.add_input("hostile", "unknown_msgs/Kind").result, "ok")
            wait_until(lambda publisher=publisher: publisher.get_num_connections() > 0, "the connection")
            message = hostile()
            message._buff = b"\1\0\0\0"
            publisher.publish(message)
            log.wait_for(
                lambda records: any(
                    "topic /hostile: expected a message type" in record.msg for record in records
                ),
                "the refusal",
            )
            self.assertEqual(self.delete_input("hostile").result, "ok")
            publisher.unregister()
            log.messages.clear()
        self.assertFalse(created_file.exists())


if __name__ == "__main__":
    rospy.init_node("services")
    rostest.rosrun("retalis", "services", Services)
