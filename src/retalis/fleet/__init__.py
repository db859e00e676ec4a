"""Many robots with one program in a stream processor: an engine for each robot, whose state the processor stores."""
