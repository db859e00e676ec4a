"""A battery discharges, with a dip under load, is charged, and discharges again, faster."""

TOPICS = {"/battery": "sensor_msgs/BatteryState"}

CHARGING, DISCHARGING = 1, 2


def messages():
    """Yield time, topic and slots of each message."""
    percentage, status = 0.375, DISCHARGING
    for step in range(90):
        dip = 0.09375 if step == 20 else 0.0
        yield 10.0 * step, "/battery", {"percentage": percentage - dip, "power_supply_status": status}
        if step == 45:
            status = CHARGING
        elif step == 60:
            status = DISCHARGING
        percentage += {45 < step <= 60: 0.015625, step > 60: -0.0078125}.get(True, -0.00390625)
