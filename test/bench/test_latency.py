"""The benchmark of the latency of nodes: options, percentiles and table, without runs on a ROS master."""

import importlib
import sys
from pathlib import Path
from typing import Any, Dict, List

import pytest

HERE = Path(__file__).resolve().parent
_path = list(sys.path)
sys.path.insert(0, str(HERE.parents[1] / "bench"))
latency = importlib.import_module("latency")
sys.path[:] = _path  # the benchmark adds to it as well, and its modules' names are those of test packages


def new_run(configuration: str, latencies: Any, rate: float = 100.0, lost: int = 0) -> Dict[str, Any]:
    return {"rate": rate, "configuration": configuration, "lost": lost, "latencies_ms": latencies}


def test_default_options_run_all_configurations() -> None:
    options = latency.arguments([])
    assert options.nodes == ["relay", "direct", "embedded", "two"]
    assert options.rates == [100.0, 1000.0]


@pytest.mark.parametrize(
    ("arguments", "problem"),
    [
        (["--rates", "fast"], "fast is not a number above zero"),
        (["--runs", "0"], "0 is not a whole number above zero"),
        (["--nodes", "three"], "invalid choice: 'three'"),
        (["--json", "nofolder/figures.json"], "there is no folder nofolder"),
    ],
)
def test_invalid_option_is_refused(
    arguments: List[str], problem: str, capsys: pytest.CaptureFixture[str]
) -> None:
    with pytest.raises(SystemExit):
        latency.arguments(arguments)
    assert problem in capsys.readouterr().err.splitlines()[-1]


@pytest.mark.parametrize(
    ("share", "value"), [(0.5, 500), (0.99, 990), (0.999, 999), (1.0, 999)], ids=["50", "99", "99.9", "100"]
)
def test_percentile_is_one_of_the_values(share: float, value: int) -> None:
    assert latency.percentile(list(range(1000)), share) == value
    assert latency.percentile([7], share) == 7
    assert latency.percentile([], share) is None


def test_runs_are_pooled_and_compared_with_relay() -> None:
    runs = [
        new_run("relay", [1.0, 2.0]),
        new_run("two", [3.0], lost=1),
        new_run("two", [1.0, 6.0], lost=1),
        new_run("two", [9.0], rate=1000.0),
    ]
    relay, two, alone = latency.summary(runs)
    assert (relay["p50"], relay["p99"], relay["of_relay"]) == (2.0, 2.0, 1.0)
    assert (two["messages"], two["lost"], two["p50"], two["of_relay"]) == (3, 2, 3.0, 3.0)
    assert alone["of_relay"] is None


def test_table_has_row_per_rate_and_configuration() -> None:
    runs = [new_run("relay", [1.0]), new_run("two", [2.5]), new_run("two", [], rate=1000.0, lost=9)]
    assert latency.table(latency.summary(runs)).splitlines()[2:] == [
        "| relay | 100 | 1.00 | 1.00 | 1.00 | 1.00 | 1 | 0 |",
        "| two | 100 | 2.50 | 2.50 | 2.50 | 2.50 | 1 | 0 |",
        "| two | 1000 |  |  |  |  | 0 | 9 |",
    ]
