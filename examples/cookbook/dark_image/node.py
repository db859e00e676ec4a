#!/usr/bin/env python3
"""The recipe as a rospy node: the mean of the middle of the image, and two limits."""

import numpy
import rospy
from sensor_msgs.msg import Image
from std_msgs.msg import String


class DarkImage:
    """Reports when the image has become dark, and bright."""

    def __init__(self):
        self._light = None
        self._publisher = rospy.Publisher("light", String, queue_size=10, latch=True)
        rospy.Subscriber("camera/image_raw", Image, self._on_image)

    def _on_image(self, message):
        height, width = message.height, message.width
        rows = numpy.array(bytearray(message.data)).reshape(height, message.step)
        image = rows[:, : 3 * width].reshape(height, width, 3)
        y, x = height // 4, width // 4
        mean = image[y : y + height // 2, x : x + width // 2].mean()
        if 40 <= mean <= 60:
            return
        light = "dark" if mean < 40 else "bright"
        if light != self._light:
            self._light = light
            self._publisher.publish(String(light))


if __name__ == "__main__":
    rospy.init_node("dark_image")
    DarkImage()
    rospy.spin()
