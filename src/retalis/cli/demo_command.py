"""Command ``demo``: runs the NAO example over a simulated bag, without ROS."""

import argparse
import importlib
import sys
import tempfile
from pathlib import Path
from typing import Any, Callable, Dict, Tuple

from ..foundation.errors import UsageError
from ..playback.bag_locations import MergedBag
from ..playback.playback import Playback
from ..prolog.terms.term_traversal import resolve
from .bag_run import progress_of
from .option_values import any_integer, positive_seconds
from .stderr_report import StderrReporter, show_progress


def add_parser(add_command: Callable[..., argparse.ArgumentParser]) -> None:
    """Add the parser of command ``demo``."""
    parser = add_command(
        "demo",
        help="run the NAO example over a bag, without ROS",
        description="Create a bag of a simulated NAO, run the NAO program over it, and print the last computed "
        "position and the true position of each marker. The exit status is 0 if all markers were located.",
    )
    parser.add_argument(
        "--bag", type=Path, metavar="BAG", help="play this bag instead (made by examples/nao/make_bag.py)"
    )
    parser.add_argument(
        "--seconds",
        type=positive_seconds,
        default=20.0,
        metavar="N",
        help="length of the simulated bag in seconds (20)",
    )
    parser.add_argument(
        "--seed", type=any_integer, default=1, metavar="N", help="random seed of the simulated bag (1)"
    )
    parser.set_defaults(run=run)


def run(options: argparse.Namespace) -> int:
    """Run the command; return its exit status."""
    report = StderrReporter().attach()
    folder = example_folder()
    # The example's modules are scripts beside its data, not part of the package.
    sys.path.append(str(folder))
    truth_module = importlib.import_module("nao_truth")
    with tempfile.TemporaryDirectory() as temporary:
        bag = options.bag
        if bag is None:
            bag = Path(temporary) / "nao.bag"
            print(
                f"a bag of a simulated NAO, {options.seconds:g} s long, is made, then played ...", flush=True
            )
            importlib.import_module("make_bag").make_bag(bag, options.seconds, options.seed)
        elif not bag.exists():
            raise UsageError(f"{bag}: there is no such file")
        try:
            truth = truth_module.load(bag)
        except OSError as error:
            raise UsageError(
                f"cannot read {error.filename}, which make_bag.py writes next to a bag"
            ) from error
        located = locate(bag, folder.parent.parent / "application_source", report)
    comparisons = truth_module.compare(truth, located)
    # The status is 1 without any comparison, too: nothing has been verified then.
    print(truth_module.table(comparisons))
    return (
        0 if comparisons and all(comparison.good for comparison in comparisons) and not report.errors else 1
    )


def locate(bag: Path, program: Path, report: StderrReporter) -> Dict[str, Tuple[float, float, float]]:
    """Run the NAO program over a bag; return the last position of each marker by its name."""
    located: Dict[str, Tuple[float, float, float]] = {}
    playback = Playback(program, report)
    with MergedBag([bag]) as bags, show_progress("messages", progress_of(playback, bags)) as bar:
        for output in playback.run(bags, bar or _nothing):
            if output.topic.startswith("marker"):
                # A geometry_msgs/PoseStamped.
                term: Any = resolve(output.term)
                # The fields of the message in their order: header, then pose with position and orientation.
                header, pose = term[1:]
                located[header[3].name.strip('"')] = pose[1][1:]
    return located


def _nothing(done: int) -> None:
    """Ignore the progress."""


def example_folder() -> Path:
    """Return the folder of the NAO example in the source tree or the installed package.

    Raises:
        UsageError: if it is in neither.
    """
    module = Path(__file__).resolve()
    for root in module.parents:
        for folder in (root / "examples" / "nao", root / "share" / "retalis" / "examples" / "nao"):
            if (folder / "make_bag.py").exists():
                return folder
    raise UsageError("the folder examples/nao is neither in the source tree nor in an installed package")
