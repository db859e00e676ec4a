"""A room whose light is switched off, flickers, and is switched on. Image rows end with two unused bytes."""

TOPICS = {"/camera/image_raw": "sensor_msgs/Image"}

WIDTH, HEIGHT = 16, 12
STEP = 3 * WIDTH + 2

LIGHT = [*[120] * 6, 70, 50, 38, 20, 12, 10, 45, 55, 48, 39, 25, 58, 61, 90, 120, 120]


def messages():
    """Yield time, topic and slots of each message."""
    for step, light in enumerate(LIGHT):
        yield (
            0.2 * step,
            "/camera/image_raw",
            {"height": HEIGHT, "width": WIDTH, "encoding": "rgb8", "step": STEP, "data": pixels(light)},
        )


def pixels(light):
    """Return the bytes of an image: a bright lamp in a corner, the room in the middle."""
    rows = []
    for y in range(HEIGHT):
        row = []
        for x in range(WIDTH):
            lamp = x < 4 and y < 3
            row += [255, 255, 255] if lamp else [light + (x + y) % 3, light, light - (x % 2)]
        rows += [*row, 255, 255]
    return rows
