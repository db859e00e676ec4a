#!/usr/bin/env python3
"""The same fleet without a stream engine, for comparison: a dictionary of robots, and a loop over the input."""

import json
import sys
from collections import defaultdict

from robot import Robot

if __name__ == "__main__":
    robots = defaultdict(Robot)
    for line in sys.stdin:
        event = json.loads(line)
        for made in robots[event["robot"]].take(event["time"], event.get("event")):
            print(json.dumps({"robot": event["robot"], **made}))
