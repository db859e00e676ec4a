"""A program for tests of cases on running nodes, and such cases."""

from pathlib import Path

RULES = """
high(X) <- level(X) where X > 3.
high(X) <- std_msgs__0__Int8(X) where X > 3.
broken(X) <- divide(X) where Y is 1 / X.
"""
GOALS = """
compile_event_file('rules.txt')
subscribe(high(X), [], std_msgs__0__Int8(X), alarm, s1)
memorize(level(X), [], X, levels, 5)
"""
TOPICS = """
<publish_subscribe>
  <subscribe_to name="scale" msg_type="std_msgs/Int8"/>
  <publish_to name="alarm" msg_type="std_msgs/Int8"/>
</publish_subscribe>
"""

CASES = """
cases:
  - name: right
    input:
      - {at: 0, event: level(4)}
      - {at: 0.2, topic: scale, message: {data: 5}}
    expect:
      outputs:
        in_order: [{topic: alarm, message: {data: 4}, within: 60}, {topic: alarm, message: {data: 5}}]
      events: {contains: [high(4), high(5)]}
      state: [{at: 0.1, query: "memory_counter(levels, N)", expect: {N: 1}}]
  - name: wrong
    until: 2
    input: [{at: 0, event: level(6)}]
    expect:
      outputs: {none: [std_msgs__0__Int8(6)]}
  - name: unconnected
    input: [{at: 0, topic: scales, type: std_msgs/Int8}]
    expect: {outputs: none}
"""
"""A case that passes on a node that has processed nothing yet, and two that fail."""


def write_program(folder: Path) -> Path:
    """Write the program; return its folder."""
    folder.mkdir()
    for name, text in (("rules.txt", RULES), ("goalPredicates.txt", GOALS), ("pub_sub.xml", TOPICS)):
        (folder / name).write_text(text)
    return folder
