#!/usr/bin/env python3
"""Run all benchmarks and write their tables and plots into ``docs/explanation/performance.md``.

    bench/performance.py [--against FOLDER] [--python PATH ...] [--ros SETUP] [--runs N]
                         [--only NAME ...] [--figures FOLDER]

``--against`` is the folder of the reference's ``bench.pl`` (``RETALIS_REF`` names its checkout), ``--python`` further
interpreters for the engine and for bags, ``--ros`` the ``setup.bash`` of a workspace in which the package is built:
without it the nodes are omitted. The figures are stored in a folder (``--figures``); with ``--only none`` the page is
written again from the stored ones.
"""

import argparse
import json
import re
import subprocess
import sys
from pathlib import Path
from typing import Any, Callable, Dict, Iterator, List, Optional

HERE = Path(__file__).resolve().parent
sys.path.insert(0, str(HERE))

from arguments import existing, interpreter, positive  # noqa: E402

DOCS = HERE.parent / "docs"
PAGE = DOCS / "explanation" / "performance.md"
NAMES = ("engine", "offline", "curves", "node")


def commands(options: argparse.Namespace) -> Dict[str, List[str]]:
    """Return the command of each benchmark."""
    others = ["--python", *options.python] if options.python else []
    against = ["--against", str(options.against)] if options.against else []
    runs = ["--runs", str(options.runs)]
    found = {
        "engine": [sys.executable, str(HERE / "engine.py"), "--all", *against, *others, *runs],
        "offline": [sys.executable, str(HERE / "offline.py"), *others, *runs],
        "curves": [sys.executable, str(HERE / "curves.py")],
    }
    if options.ros:
        node = ["python3", str(HERE / "live_node.py"), "--memory", "1000000", "--starts", "5", *runs]
        found["node"] = ["bash", "-c", 'source "$0" && exec "$@"', str(options.ros), *node]
    return found


def run(options: argparse.Namespace) -> None:
    """Run the selected benchmarks, which store and draw their figures."""
    options.figures.mkdir(parents=True, exist_ok=True)
    for name, command in commands(options).items():
        if name in options.only:
            where = ["--json", str(options.figures / f"{name}.json")]
            if name == "engine":
                where += ["--plot", str(DOCS / "images" / "performance-engine.png")]
            subprocess.run([*command, *where], check=True)
            if name == "node":
                from performance_plots import draw_node

                draw_node(
                    json.loads((options.figures / "node.json").read_text()),
                    str(DOCS / "images" / "performance-node.png"),
                )


def table(head: List[str], rows: List[List[str]]) -> Iterator[str]:
    """Yield the lines of a table."""
    yield "| " + " | ".join(head) + " |"
    yield "| --- |" + " ---: |" * (len(head) - 1)
    for row in rows:
        yield "| " + " | ".join(row) + " |"


def number(value: Optional[float], digits: int = 2) -> str:
    """Return a figure as text; blank if there is none."""
    return "" if value is None else f"{value:.{digits}f}"


def engine(result: Dict[str, Any]) -> Iterator[str]:
    """Yield the section on the engine's cases."""
    cases = result["cases"]
    columns = list(dict.fromkeys(column for row in cases.values() for column in row))
    rows = []
    for name, row in cases.items():
        ratio = f"1/{row['reference'] / row['terms']:.1f}" if "reference" in row else ""
        rows.append([f"`{name}`", *(number(row.get(column)) for column in columns), ratio])
    yield f"Microseconds an event, {runs(result['runs'])}. {machine(result)}"
    yield ""
    yield from table(["case", *columns, "of the reference"], rows)


def offline(result: Dict[str, Any]) -> Iterator[str]:
    """Yield the section on bags."""
    rows = [
        [
            python,
            number(row["start"]),
            number(row["run"]),
            f"{row['messages']:.0f}",
            number(1e6 * row["run"] / row["messages"]),
        ]
        for python, row in result["rows"].items()
    ]
    yield f"{result['seconds']:.0f} seconds of the NAO's bag, in seconds of CPU. {machine(result)}"
    yield ""
    yield from table(["Python", "start", "run", "messages", "us a message"], rows)


def curves(result: Dict[str, Any]) -> Iterator[str]:
    """Yield the section on growth."""
    rows = [
        [
            row["title"] + (" (each event concerns all)" if row["grows"] else ""),
            ", ".join(f"{size:g}: {us:.2f}" for size, us in row["points"]),
            number(row["exponent"]),
        ]
        for row in result["rows"].values()
    ]
    yield f"Microseconds at each N, and the exponent of the growth over the upper half. {machine(result)}"
    yield ""
    yield from table(["N items", "microseconds", "exponent"], rows)


def node(result: Dict[str, Any]) -> Iterator[str]:
    """Yield the section on the nodes."""
    rows = []
    for row in result["rows"]:
        by_node = " + ".join(number(value, 1) for _, value in sorted(row["by_node"].items()))
        memory = " + ".join(number(value, 0) for _, value in sorted(row["resident_mb"].items()))
        rows.append(
            [
                f"{row['way']}, {row['speed']:g}x",
                number(row["messages_a_second"], 0),
                by_node,
                number(row.get("to_idle")),
                number(row.get("delay_ms_median")),
                number(row.get("delay_ms_99")),
                str(row["lost"] + row["drops_reported"]),
                f"{row['poses']}/{row['expected']}" if row["expected"] else "",
                memory,
            ]
        )
    head = ["way", "messages/s", "CPU %", "idle = 1", "delay ms", "99 %", "lost", "poses", "MB"]
    yield f"Figures are {runs(result['rows'][0]['runs'])}. {machine(result)}"
    yield ""
    yield from table(head, rows)
    held = result.get("memory")
    if held:
        yield ""
        yield (
            f"Resident memory over {held[-1][0]:,.0f} messages: {held[1][1]:.1f} MB after {held[1][0]:,.0f}, "
            f"{held[-1][1]:.1f} MB at the end."
        )
    start = result.get("starts")
    if start:
        yield ""
        yield (
            f"Start: importing rospy {start['rospy']:.2f} s ({start['rospy_cpu']:.2f} s of CPU), the node with the "
            f"NAO's program ready {start['beyond']:.2f} s after that ({start['beyond_cpu']:.2f} s of CPU)."
        )


def runs(number: int) -> str:
    """Return the description of the runs."""
    return "of one run each" if number == 1 else f"medians of {number} alternating runs"


def machine(result: Dict[str, Any]) -> str:
    """Return the sentence that names the machine."""
    found = result["machine"]
    return f"{found['cpu']}, {found['cores']} cores, {found['python']}."


SECTIONS: Dict[str, Callable[[Dict[str, Any]], Iterator[str]]] = {
    "engine": engine,
    "offline": offline,
    "curves": curves,
    "node": node,
}


def write_page(figures: Path, page: Path) -> None:
    """Write the tables between the markers of their sections."""
    text = page.read_text(encoding="utf-8")
    for name, section in SECTIONS.items():
        file = figures / f"{name}.json"
        if file.exists():
            lines = "\n".join(section(json.loads(file.read_text())))
            mark = re.compile(f"<!-- {name} -->\n.*?<!-- end of {name} -->", re.DOTALL)
            made = f"<!-- {name} -->\n{lines}\n<!-- end of {name} -->"
            text = mark.sub(lambda found, made=made: made, text)  # type: ignore[misc]
    page.write_text(text, encoding="utf-8")


def main() -> int:
    """Run the benchmark that the command line selects."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--against", type=existing)
    parser.add_argument("--python", type=interpreter, nargs="+", default=[])
    parser.add_argument("--ros", type=existing)
    parser.add_argument("--runs", type=positive, default=5)
    parser.add_argument("--only", nargs="+", choices=[*NAMES, "none"], default=list(NAMES))
    parser.add_argument("--figures", type=Path, default=HERE / "figures")
    options = parser.parse_args()
    run(options)
    write_page(options.figures, PAGE)
    return 0


if __name__ == "__main__":
    raise SystemExit(main())
