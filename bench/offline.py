#!/usr/bin/env python3
"""Playback of a bag without ROS: CPU time of the NAO's program after the start.

    bench/offline.py [--seconds N] [--runs N] [--python PATH ...] [--json FILE] [--plot FILE]

Prints a line for each interpreter: seconds until the program is loaded, seconds of the playback, microseconds per
message.
"""

import argparse
import json
import statistics
import subprocess
import sys
import tempfile
import time
from pathlib import Path
from typing import Any, Dict, List, Optional

HERE = Path(__file__).resolve().parent
sys.path[:0] = [str(HERE), str(HERE.parent / "src"), str(HERE.parent / "examples" / "nao")]

from arguments import above_zero, existing, interpreter, positive, target  # noqa: E402

from retalis import RetalisError  # noqa: E402


def once(bag: Path) -> Dict[str, float]:
    """Run the program over a bag in this process; return the figures."""
    from retalis import BagReader, Playback, limit_gc_pauses

    playback = Playback(HERE.parent / "application_source", report=print)
    limit_gc_pauses()
    loaded = time.process_time()
    with BagReader(bag) as reader:
        outputs = sum(1 for _ in playback.run(reader))
        messages = reader.messages
    return {
        "start": loaded,
        "run": time.process_time() - loaded,
        "messages": messages,
        "outputs": outputs,
    }


def measure(options: argparse.Namespace) -> Dict[str, Any]:
    """Return the medians for each interpreter."""
    from make_bag import make_bag
    from processes import machine

    runs: Dict[str, List[Dict[str, float]]] = {}
    with tempfile.TemporaryDirectory() as folder:
        bag = str(Path(folder) / "nao.bag")
        make_bag(bag, options.seconds, 1)
        for _ in range(options.runs):
            for python in [sys.executable, *options.python]:
                ran = subprocess.run([python, __file__, "--once", bag], capture_output=True, text=True)
                if ran.returncode:
                    raise SystemExit(ran.stderr)
                figures = json.loads(ran.stdout)
                runs.setdefault(figures.pop("python"), []).append(figures)
    rows = {
        python: {key: statistics.median(run[key] for run in found) for key in found[0]}
        for python, found in runs.items()
    }
    return {"machine": machine(), "seconds": options.seconds, "rows": rows}


def line(python: str, row: Dict[str, float]) -> str:
    """Return a table row as text."""
    return (
        f"python {python}  start {row['start']:.2f} s  run {row['run']:.2f} s  {row['messages']:.0f} messages  "
        f"{1e6 * row['run'] / row['messages']:.2f} us each  outputs {row['outputs']:.0f}"
    )


def main(given: Optional[List[str]] = None) -> int:
    """Run the benchmark that the command line selects."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--seconds", type=above_zero, default=60.0, help="length of the bag")
    parser.add_argument("--runs", type=positive, default=5)
    parser.add_argument("--python", type=interpreter, nargs="+", default=[], help="further interpreters")
    parser.add_argument("--json", type=target, help="write the figures there")
    parser.add_argument("--plot", type=target, help="draw them there")
    parser.add_argument("--once", type=existing, metavar="BAG", help=argparse.SUPPRESS)
    options = parser.parse_args(given)
    if options.once:
        version = ".".join(map(str, sys.version_info[:3]))
        print(json.dumps({"python": version, **once(options.once)}))
        return 0
    try:
        result = measure(options)
    except RetalisError as error:  # no bag can be made
        raise SystemExit(str(error)) from error
    for python, row in result["rows"].items():
        print(line(python, row))
    if options.json:
        Path(options.json).write_text(json.dumps(result, indent=1) + "\n")
    if options.plot:
        from performance_plots import draw_offline

        draw_offline(result, options.plot)
    return 0


if __name__ == "__main__":
    raise SystemExit(main())
