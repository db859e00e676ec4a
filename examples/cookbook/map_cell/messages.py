"""A small map, rotated by 90 degrees, with goals inside and outside, and a second map without one of the walls."""

TOPICS = {"/map": "nav_msgs/OccupancyGrid", "/goal": "geometry_msgs/PoseStamped"}

ROOM = ["##########", "#........#", "#..##....#", "#..##..???", "##########"]
"""Rows of the map from the bottom to the top."""

CELLS = {"#": 100, ".": 0, "?": -1}
GOALS = [(1.1, 1.6), (1.7, 2.1), (-0.3, 5.6), (-2.0, 3.1), (0.4, 1.2), (0.6, 3.3), (0.3, 4.7)]


def messages():
    """Yield time, topic and slots of each message."""
    yield 0.0, "/map", grid(ROOM)
    for step, (x, y) in enumerate(GOALS):
        yield 1.0 + step, "/goal", goal(x, y)
    yield 10.0, "/map", grid([row.replace("##..", "....") for row in ROOM])
    for step, (x, y) in enumerate(GOALS):
        yield 11.0 + step, "/goal", goal(x, y)


def grid(rows):
    """Return a map with cells of half a metre. The rows run along y, to the left of the corner at (2, 1)."""
    origin = {
        "position": {"x": 2.0, "y": 1.0},
        "orientation": {"z": 0.7071067811865476, "w": 0.7071067811865476},
    }
    info = {"resolution": 0.5, "width": len(rows[0]), "height": len(rows), "origin": origin}
    return {
        "header": {"frame_id": "map"},
        "info": info,
        "data": [CELLS[cell] for row in rows for cell in row],
    }


def goal(x, y):
    """Return a goal at a point of the map."""
    return {"header": {"frame_id": "map"}, "pose": {"position": {"x": x, "y": y}, "orientation": {"w": 1.0}}}
