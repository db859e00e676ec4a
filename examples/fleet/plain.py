#!/usr/bin/env python3
"""The same without a stream engine, to compare with: a dictionary of robots, and a loop from input to output."""

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
