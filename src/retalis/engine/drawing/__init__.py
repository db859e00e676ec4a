"""What a program is and what happened in a run, as models of pictures."""

from .graph import Graph, GraphTopic, graph_key, program_graph

__all__ = [
    "Graph",
    "graph_key",
    "GraphTopic",
    "program_graph",
]
