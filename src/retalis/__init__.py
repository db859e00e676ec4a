"""Event rules and a Prolog knowledge base for robots, on ROS 1 and without it."""

from pkgutil import extend_path

# catkin puts the generated retalis.msg and retalis.srv into a folder of their own, in devel space: both are `retalis`
__path__ = extend_path(__path__, __name__)
