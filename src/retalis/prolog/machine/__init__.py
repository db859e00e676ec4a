"""The abstract machine: frames, choice points, trail, errors and limits."""
