#!/usr/bin/env python3
"""Events of robots from a broker of MQTT to a log that the fleet follows: bridge.py HOST PORT LOG."""

import sys
from pathlib import Path

from retalis.fleet.mqtt_bridge import MqttBridge

if __name__ == "__main__":
    host, port, log = sys.argv[1:]
    MqttBridge(host, int(port), Path(log), max_bytes=10_000_000_000).run()
