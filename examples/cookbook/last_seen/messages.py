"""A cup is moved and a pen is not; a user asks for both, and for a plate that was never seen."""

TOPICS = {"/objects": "geometry_msgs/TransformStamped", "/where_is": "std_msgs/String"}


def messages():
    """Yield time, topic and slots of each message."""
    for step in range(6):
        yield 1.0 * step, "/objects", sighting("cup", 0.5 * step, 1.0)
    for step in range(3):
        yield 6.5 + step, "/objects", sighting("pen", 4.0, 2.5)
    for time, name in ((3.25, "cup"), (3.75, "pen"), (9.0, "cup"), (9.5, "pen"), (10.0, "plate")):
        yield time, "/where_is", {"data": name}


def sighting(name, x, y):
    """Return the slots of a sighting on the map."""
    place = {"translation": {"x": x, "y": y}}
    return {"header": {"frame_id": "map"}, "child_frame_id": name, "transform": place}
