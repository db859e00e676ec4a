"""Commands ``demo`` and ``docs``, which use files beside the package: the NAO example and the documentation site.

Both folders are searched in the source tree of a clone and below the root of an installation.
"""

import argparse
import importlib
import sys
import tempfile
import webbrowser
from contextlib import contextmanager
from pathlib import Path
from typing import Any, Callable, Dict, Iterator, Tuple

from ..foundation.errors import UsageError
from ..foundation.output_files import print_json
from .option_values import any_integer, positive_seconds
from .progress_bar import show_progress
from .stderr_reports import StderrReporter

SOURCE_EXAMPLE = Path("examples", "nao")
"""Folder of the NAO example in the source tree."""

INSTALLED_EXAMPLE = Path("share", "retalis", "examples", "nao")
"""Folder of the NAO example below the root of an installation."""

SOURCE_SITE = Path("docs", "_build", "html")
"""Folder of the built site in the source tree."""

INSTALLED_SITE = Path("share", "retalis", "docs", "html")
"""Folder of the site below the root of an installation."""


DEMO_JSON_HELP = """\
with --json each line is one object, first the outputs as "bag --json" prints them; positions and errors in metres:
  {"output": TERM, "topic": TOPIC, "id": ID, "time": T}
  {"marker": NAME, "located": [X, Y, Z] or null, "true": [X, Y, Z], "error": NUMBER or null}
"""


def add_demo_parser(add_command: Callable[..., argparse.ArgumentParser]) -> None:
    """Add the parser of command ``demo``."""
    parser = add_command(
        "demo",
        help="run the NAO example over a bag, without ROS",
        description="Create a bag of a simulated NAO, run the NAO program over it, and print the last computed "
        "position and the true position of each marker. The exit status is 0 if all markers were located.",
        epilog=DEMO_JSON_HELP,
        formatter_class=argparse.RawDescriptionHelpFormatter,
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
    parser.add_argument(
        "--json",
        action="store_true",
        help="print one JSON object per output and per marker instead of the table",
    )
    parser.set_defaults(run=run_demo)


def run_demo(options: argparse.Namespace) -> int:
    """Run command ``demo``; return its exit status."""
    reporter = StderrReporter().attach()
    folder = example_folder()
    with tempfile.TemporaryDirectory() as temporary, module_folder(folder):
        truth_module = importlib.import_module("nao_truth")
        bag = options.bag
        if bag is None:
            bag = Path(temporary) / "nao.bag"
            print(
                f"a bag of a simulated NAO, {options.seconds:g} s long, is made, then played ...",
                file=sys.stderr if options.json else None,
                flush=True,
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
        program = folder.parent.parent / "application_source"
        located = locate_markers(bag, program, reporter, options.json)
    comparisons = truth_module.compare(truth, located)
    if options.json:
        for comparison in comparisons:
            print_json(comparison._asdict())
    else:
        print(truth_module.table(comparisons))
    # The status is 1 without any comparison, too: nothing has been verified then.
    return (
        0 if comparisons and all(comparison.good for comparison in comparisons) and not reporter.errors else 1
    )


@contextmanager
def module_folder(folder: Path) -> Iterator[None]:
    """Find modules in a folder, too: the example's modules are scripts beside its data, not part of the package."""
    search_path = list(sys.path)
    sys.path.append(str(folder))
    try:
        yield
    finally:
        sys.path[:] = search_path


def locate_markers(
    bag: Path, program: Path, reporter: StderrReporter, prints_outputs: bool
) -> Dict[str, Tuple[float, float, float]]:
    """Run the NAO program over a bag; return the last position of each marker by its name.

    Args:
        bag: the bag.
        program: folder of the program.
        reporter: receives errors.
        prints_outputs: whether to print each output as JSON.
    """
    # Imported here, because command `docs` needs no engine.
    from ..playback.bag_locations import MergedBag  # noqa: PLC0415
    from ..playback.playback import Playback, make_output_record  # noqa: PLC0415
    from ..prolog.terms.term_traversal import resolve  # noqa: PLC0415
    from .bag_command import elapsed_fraction  # noqa: PLC0415

    located: Dict[str, Tuple[float, float, float]] = {}
    playback = Playback(program, reporter)
    with MergedBag([bag]) as bags, show_progress("messages", lambda: elapsed_fraction(playback, bags)) as bar:
        for output in playback.run(bags, bar or _ignore_progress):
            if prints_outputs:
                print_json(make_output_record(output))
            if output.topic.startswith("marker"):
                # A geometry_msgs/PoseStamped.
                term: Any = resolve(output.term)
                # The fields of the message in their order: header, then pose with position and orientation.
                header, pose = term[1:]
                located[header[3].name.strip('"')] = pose[1][1:]
    return located


def _ignore_progress(message_count: int) -> None:
    """Do nothing: without a terminal there is no progress bar."""


def example_folder() -> Path:
    """Return the folder of the NAO example.

    Raises:
        UsageError: if it is neither in the source tree nor in the installed package.
    """
    error = "the folder examples/nao is neither in the source tree nor in an installed package"
    return _find_folder(SOURCE_EXAMPLE, INSTALLED_EXAMPLE, "make_bag.py", error)


def add_docs_parser(add_command: Callable[..., argparse.ArgumentParser]) -> None:
    """Add the parser of command ``docs``."""
    parser = add_command(
        "docs",
        help="open the documentation in the browser",
        description="Open the documentation site in the browser. The site is part of the installed package; in a "
        "clone, ./install.py docs builds it. It needs no network. Exit status 1 if there is no site or no browser.",
    )
    parser.add_argument(
        "--print-path", action="store_true", help="print the path of the start page instead of opening it"
    )
    parser.add_argument("--json", action="store_true", help='print it as a JSON object, {"path": PATH}')
    parser.set_defaults(run=open_site)


def open_site(options: argparse.Namespace) -> int:
    """Run command ``docs``; return its exit status."""
    page = find_site() / "index.html"
    if options.json:
        print_json({"path": str(page)})
    elif options.print_path:
        print(page)
    elif not webbrowser.open(page.as_uri()):
        print(f"retalis docs: no browser can be started: open {page}", file=sys.stderr)
        return 1
    return 0


def find_site() -> Path:
    """Return the folder of the documentation site.

    Raises:
        UsageError: if it is neither in the source tree nor in the installed package.
    """
    error = (
        "the documentation site is not built: run ./install.py docs in a clone of retalis; "
        "a wheel that is built afterwards contains the site"
    )
    return _find_folder(SOURCE_SITE, INSTALLED_SITE, "index.html", error)


def _find_folder(source_folder: Path, installed_folder: Path, content: str, error: str) -> Path:
    """Return a folder, given below the root of the source tree and of the installation, that contains a file.

    Raises:
        UsageError: with the text ``error`` if there is none.
    """
    # The root is some parent of this module: how many levels above it depends on the kind of installation.
    for root in Path(__file__).resolve().parents:
        for folder in (root / source_folder, root / installed_folder):
            if (folder / content).is_file():
                return folder
    raise UsageError(error)
