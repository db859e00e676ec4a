"""What a program is and what happened in a run, as models of pictures."""

from .dot import FORMATS, dot_text, draw
from .graph import Graph, GraphTopic, graph_key, program_graph

__all__ = [
    "dot_text",
    "draw",
    "FORMATS",
    "Graph",
    "graph_key",
    "GraphTopic",
    "program_graph",
]
