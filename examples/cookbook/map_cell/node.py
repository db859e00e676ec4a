#!/usr/bin/env python3
"""The recipe as a rospy node: the last map, and the cell of each goal."""

import math
import threading

import rospy
from geometry_msgs.msg import PoseStamped
from nav_msgs.msg import OccupancyGrid
from std_msgs.msg import String


class MapCell:
    """Refuses goals that are not free on the map."""

    def __init__(self):
        self._lock = threading.Lock()
        self._map = None
        self._refused = rospy.Publisher("refused", String, queue_size=10)
        rospy.Subscriber("map", OccupancyGrid, self._on_map)
        rospy.Subscriber("goal", PoseStamped, self._on_goal)

    def _on_map(self, message):
        with self._lock:
            self._map = message

    def _on_goal(self, message):
        with self._lock:
            grid = self._map
        if grid is None:
            return
        place = message.pose.position
        what = kind(cell(grid, place.x, place.y))
        if what != "free":
            self._refused.publish(String(f"{place.x:.2f} {place.y:.2f}: {what}"))


def cell(grid, x, y):
    """Return the value of the cell at a point, None outside of the map."""
    info = grid.info
    turn = 2 * math.atan2(info.origin.orientation.z, info.origin.orientation.w)
    dx, dy = x - info.origin.position.x, y - info.origin.position.y
    column = math.floor((math.cos(turn) * dx + math.sin(turn) * dy) / info.resolution)
    row = math.floor((math.cos(turn) * dy - math.sin(turn) * dx) / info.resolution)
    if 0 <= column < info.width and 0 <= row < info.height:
        return grid.data[row * info.width + column]
    return None


def kind(value):
    if value is None:
        return "outside"
    return "unknown" if value < 0 else "occupied" if value >= 65 else "free"


if __name__ == "__main__":
    rospy.init_node("map_cell")
    MapCell()
    rospy.spin()
