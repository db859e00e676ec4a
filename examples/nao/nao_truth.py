"""True positions of the markers in a simulated NAO bag, and errors of located positions.

The file beside the bag (``FILE.truth.json`` for ``FILE.bag``) is JSON:

* ``seconds``, ``seed``, ``start``: what the bag was made with; ``start`` in nanoseconds.
* ``frame``: the frame of all positions, ``/odom``, which is the world.
* ``markers``: by name, ``position`` [x, y, z] in metres and ``orientation`` [x, y, z, w]. They do not move.
* ``observations``: in the order of receipt, each with ``marker``, ``stamp`` and ``received`` in nanoseconds,
  and ``complete``: whether the stamp lies within the data of all five links, so that there is a pose.
"""

import json
from pathlib import Path
from typing import Dict, Iterable, List, Mapping, NamedTuple, Optional, Sequence, Tuple, Union

from nao_robot import Pose, Vector, distance

PathLike = Union[str, Path]

TOLERANCE = 0.02
"""Maximum distance of a located marker from its true position, in metres."""


class Observation(NamedTuple):
    """Observation of a marker: stamp and receipt in nanoseconds, and whether its pose can be computed."""

    marker: str
    stamp: int
    received: int
    complete: bool


class Truth(NamedTuple):
    """True positions of the markers of a bag, and their observations."""

    seconds: float
    seed: int
    start: int
    markers: Dict[str, Pose]
    observations: List[Observation]

    @property
    def complete(self) -> List[Observation]:
        """The observations whose pose can be computed; each leads to exactly one pose."""
        return [observation for observation in self.observations if observation.complete]


class Comparison(NamedTuple):
    """Located and true position of a marker and their distance in metres; None if it was not located."""

    marker: str
    located: Optional[Vector]
    true: Vector
    error: Optional[float]

    @property
    def good(self) -> bool:
        """Whether the marker was located within the tolerance."""
        return self.error is not None and self.error <= TOLERANCE


def truth_path(bag: PathLike) -> Path:
    """Return the file with the truth of a bag."""
    return Path(bag).with_suffix(".truth.json")


def save(truth: Truth, bag: PathLike) -> Path:
    """Write the truth of a bag to a file next to it; return the file."""
    path = truth_path(bag)
    content = {
        "seconds": truth.seconds,
        "seed": truth.seed,
        "start": truth.start,
        "frame": "/odom",
        "markers": {
            name: {"position": list(position), "orientation": list(rotation)}
            for name, (position, rotation) in truth.markers.items()
        },
        "observations": [observation._asdict() for observation in truth.observations],
    }
    path.write_text(json.dumps(content, indent=1) + "\n", encoding="utf-8")
    return path


def load(bag: PathLike) -> Truth:
    """Return the truth of a bag.

    Raises:
        OSError: where no truth is beside it, as with bags of real robots.
    """
    content = json.loads(truth_path(bag).read_text(encoding="utf-8"))
    markers: Dict[str, Pose] = {
        name: (tuple(marker["position"]), tuple(marker["orientation"]))  # type: ignore[misc]
        for name, marker in content["markers"].items()
    }
    observations = [Observation(**observation) for observation in content["observations"]]
    return Truth(content["seconds"], content["seed"], content["start"], markers, observations)


def compare(truth: Truth, located: Mapping[str, Sequence[float]]) -> List[Comparison]:
    """Compare the located positions of markers, by name, with the true ones."""
    comparisons = []
    for name, (true, _) in truth.markers.items():
        place = located.get(name)
        found: Optional[Vector] = None if place is None else (place[0], place[1], place[2])
        comparisons.append(Comparison(name, found, true, None if found is None else distance(found, true)))
    return comparisons


def table(comparisons: Iterable[Comparison]) -> str:
    """Return comparisons as a table: position of the marker, truth, error."""
    lines = [f"{'marker':<8} {'located (m)':^26} {'true (m)':^26} {'error':>8}"]
    for marker, located, true, error in comparisons:
        place = "not located" if located is None else _place(located)
        shown = "" if error is None else f"{error * 1000:.1f} mm"
        lines.append(f"{marker:<8} {place:^26} {_place(true):^26} {shown:>8}")
    return "\n".join(lines)


def _place(place: Tuple[float, ...]) -> str:
    return " ".join(f"{value:8.3f}" for value in place)
