"""What a program is and what happened in a run, as models of pictures."""

from .dot import FORMATS, dot_text, draw
from .graph import Graph, GraphTopic, graph_key, program_graph
from .plot import PICTURES, draw_timeline, page
from .timeline import Timeline, TimelineBuilder, read_run

__all__ = [
    "dot_text",
    "draw",
    "draw_timeline",
    "FORMATS",
    "Graph",
    "graph_key",
    "GraphTopic",
    "page",
    "PICTURES",
    "program_graph",
    "read_run",
    "Timeline",
    "TimelineBuilder",
]
