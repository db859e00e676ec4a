"""A person approaches and speaks; a noise without a person; a silent person; a noise three seconds later."""

TOPICS = {"/sonar": "sensor_msgs/Range", "/loudness": "std_msgs/Float32"}


def messages():
    """Yield time, topic and slots of each message."""
    near = {5: 0.75, 6: 0.5, 7: 0.5, 40: 0.75, 41: 0.625}
    for step in range(60):
        yield 0.2 * step, "/sonar", {"max_range": 4.0, "range": near.get(step, 3.0)}
    for time, loudness in ((0.3, 0.125), (2.7, 0.75), (5.0, 0.875), (6.1, 0.25), (11.3, 0.75)):
        yield time, "/loudness", {"data": loudness}
