"""A range finder in front of glass: single bad readings, five in a row, and an unsteady recovery."""

TOPICS = {"/distance": "sensor_msgs/Range"}

READINGS = "+++-++--++-----+--+-+++++--+++"


def messages():
    """Yield time, topic and slots of each message."""
    for number, reading in enumerate(READINGS):
        distance = 1.5 if reading == "+" else float("nan" if number % 3 == 0 else "inf")
        slots = {"min_range": 0.25, "max_range": 4.0, "range": distance}
        yield 0.1 * number, "/distance", slots
