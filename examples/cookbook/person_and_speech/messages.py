"""Ann approaches and speaks; a radio speaks while nobody is near; Bob speaks from a distance, then approaches."""

TOPICS = {"/people": "geometry_msgs/TransformStamped", "/speech": "std_msgs/String"}


def messages():
    """Yield time, topic and slots of each message."""
    for step in range(15):
        yield 1.0 + 0.2 * step, "/people", person("ann", 3.0 - 0.2 * step)
    for step in range(20):
        yield 10.0 + 0.2 * step, "/people", person("bob", 4.5 - 0.2 * step)
    said = (
        (2.7, "bring the cup"),
        (6.0, "and now the news"),
        (10.5, "hello"),
        (12.1, "follow me"),
        (17.0, "so"),
    )
    for time, text in said:
        yield time, "/speech", {"data": text}


def person(name, distance):
    """Return the slots of a person who stands before the camera."""
    place = {"translation": {"x": distance}}
    return {"header": {"frame_id": "camera"}, "child_frame_id": name, "transform": place}
