#!/usr/bin/env python3
"""Draw the pictures of the pages on performance and scaling anew, from the tables on these pages.

    bench/redraw.py [--folder docs]

For a change of the pictures without new measurements. What stands in no table is left as it is (memory over half
matches, partners that came in any order) or left out (memory over messages).
"""

import argparse
import re
from pathlib import Path
from typing import Any, Dict, Iterator, List, Tuple

DOCS = Path(__file__).resolve().parent.parent / "docs"

SECTIONS = {
    "Told apart by a variable": "values",
    "All alike": "alike",
    "Told apart by their times only": "times",
}
"""Headings of the page on scaling, and the setting of the table below each."""


def main() -> None:
    """Do what the command line says."""
    parser = argparse.ArgumentParser(description=__doc__.partition("\n")[0])
    parser.add_argument("--folder", type=Path, default=DOCS, help="where to write them")
    folder = str(parser.parse_args().folder)
    import event_plots
    import performance_plots

    page = (DOCS / "performance.md").read_text(encoding="utf-8")
    performance_plots.draw_engine(engine(page), f"{folder}/performance-engine.png")
    performance_plots.draw_offline(offline(page), f"{folder}/performance-offline.png")
    performance_plots.draw_curves(curves(page), f"{folder}/performance-curves.png")
    performance_plots.draw_node(node(page), f"{folder}/performance-node.png")
    page = (DOCS / "scaling.md").read_text(encoding="utf-8")
    event_plots.draw({"rows": list(scaling(page)), "memory": {}}, f"{folder}/scaling")


def section(page: str, name: str) -> str:
    """Return what stands between the marks of a section."""
    return page.partition(f"<!-- {name} -->")[2].partition(f"<!-- end of {name} -->")[0]


def table(text: str) -> Iterator[Dict[str, str]]:
    """Yield the rows of a Markdown table by the names of its columns."""
    lines = [line for line in text.splitlines() if line.startswith("|")]
    rows = [[cell.strip().strip("`") for cell in line.strip("|").split("|")] for line in lines]
    for row in rows[2:]:
        yield dict(zip(rows[0], row))


def engine(page: str) -> Dict[str, Any]:
    """Return the microseconds of each case by column."""
    cases = {}
    for row in table(section(page, "engine")):
        name = row.pop("case")
        row.pop("of the reference")
        cases[name] = {column: float(value) for column, value in row.items() if value}
    return {"cases": cases}


def offline(page: str) -> Dict[str, Any]:
    """Return the seconds of each interpreter, and of the bag."""
    text = section(page, "offline")
    rows = {row["Python"]: {part: float(row[part]) for part in ("start", "run")} for row in table(text)}
    return {"rows": rows, "seconds": float(text.split()[0])}


def curves(page: str) -> Dict[str, Any]:
    """Return the points and exponent of each curve."""
    rows = {}
    for row in table(section(page, "curves")):
        title = re.sub(r" \(.*\)$", "", row["what there are N of"])
        pairs = (part.split(": ") for part in row["microseconds"].split(", "))
        points = [(float(size), float(cost)) for size, cost in pairs]
        rows[title] = {"title": title, "points": points, "exponent": float(row["exponent"])}
    return {"rows": rows}


def node(page: str) -> Dict[str, Any]:
    """Return CPU and delay of each way at each speed."""
    rows: List[Dict[str, Any]] = []
    for row in table(section(page, "node")):
        found: Dict[str, Any] = {
            "way": row["way"].partition(",")[0],
            "messages_a_second": float(row["messages/s"]),
            "cpu_percent": sum(float(part) for part in row["CPU %"].split(" + ")),
        }
        if row["delay ms"]:
            found.update(delay_ms_median=float(row["delay ms"]), delay_ms_99=float(row["99 %"]))
        rows.append(found)
    return {"rows": rows}


def scaling(page: str) -> Iterator[Dict[str, Any]]:
    """Yield the microseconds for each result, by setting, operator, policy and what waits."""
    for part in re.split(r"^## ", page, flags=re.MULTILINE)[1:]:
        heading, _, text = part.partition("\n")
        if heading not in SECTIONS:
            continue
        for row in table(text):
            key: Tuple[str, str] = (row.pop("operator"), row.pop("policy"))
            for waiting, cost in row.items():
                if cost:
                    yield {
                        "setting": SECTIONS[heading],
                        "operator": key[0],
                        "policy": key[1],
                        "waiting": int(waiting.replace(",", "")),
                        "us": float(cost),
                        "results": 1,
                    }


if __name__ == "__main__":
    main()
