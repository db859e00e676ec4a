"""Parameters of a node: defaults, conversions and errors."""

import re
from pathlib import Path
from typing import Any

import pytest

from retalis import Limits, Settings, TopicType, UsageError
from retalis.dashboard.page_server import DASHBOARD_PORT
from retalis.node.parameters import (
    FIXED_PARAMETERS,
    PARAMETER_DESCRIPTIONS,
    check_adjustable,
    read_adjustable_parameters,
    read_parameters,
)
from retalis.prolog.machine.resource_limits import NO_LIMITS


@pytest.fixture
def read(monkeypatch: pytest.MonkeyPatch) -> Any:
    monkeypatch.setattr(Path, "is_dir", lambda path: path.parts[1:2] != ("nowhere",))

    def read(folder: str = "/some/package", **values: Any) -> Any:
        return read_parameters(values, lambda: Path(folder) / "application_source")

    return read


def test_defaults_of_parameters(read: Any) -> None:
    parameters = read()
    assert parameters.program == Path("/some/package/application_source")
    assert (parameters.direct, parameters.embedded, parameters.queue) == ("auto", False, 5000)
    assert not parameters.settings.allow_goals
    assert parameters.settings.max_depth == Settings().max_depth


def test_hardware_id_is_a_text(read: Any) -> None:
    assert read().hardware_id == read(hardware_id="").hardware_id == "retalis"
    assert read(hardware_id="robot7").hardware_id == "robot7"


def test_limit_0_disables_default(read: Any) -> None:
    settings = read().settings
    assert settings.limits == Limits(10.0, None, 500)
    assert (settings.watchdog, settings.limit_start) == (1.0, False)
    zeros = dict.fromkeys(("max_seconds", "max_inferences", "max_megabytes", "max_output_megabytes"), 0)
    settings = read(watchdog=0.0, **zeros).settings
    assert (settings.limits, settings.watchdog) == (NO_LIMITS, None)


def test_limits_are_integers_or_floats(read: Any) -> None:
    limits = read(
        max_seconds=2, max_inferences=1e6, max_megabytes=0.5, max_output_megabytes=3
    ).settings.limits
    assert limits == (2.0, 1_000_000, 0.5, 3.0)
    assert isinstance(limits.inferences, int)


def test_max_skew_is_unlimited_by_default(read: Any) -> None:
    assert read().max_skew is None
    assert read(max_skew=0).max_skew is None
    assert read(max_skew=2).max_skew == 2.0
    with pytest.raises(UsageError, match="~max_skew"):
        read(max_skew="much")


def test_max_gap_is_unlimited_by_default(read: Any) -> None:
    assert read().settings.max_gap is None
    assert read(max_gap=0).settings.max_gap is None
    assert read(max_gap=0.5).settings.max_gap == 0.5
    assert read().settings.tf_cache == 10.0
    assert read(tf_cache=30).settings.tf_cache == 30.0
    with pytest.raises(UsageError, match="~tf_cache"):
        read(tf_cache=0)
    with pytest.raises(UsageError, match="~max_gap"):
        read(max_gap=-1)


def test_watermark_delay_is_auto_or_number(read: Any) -> None:
    assert (read().settings.watermark_delay, read().settings.max_watermark_delay) == (None, 1)
    assert read(watermark_delay="auto").settings.watermark_delay is None
    assert read(watermark_delay=0).settings.watermark_delay == 0
    assert read(max_watermark_delay=0.5).settings.max_watermark_delay == 0.5
    for parameter in ("watermark_delay", "max_watermark_delay"):
        with pytest.raises(UsageError, match=f"~{parameter}"):
            read(**{parameter: "much"})


def test_program_replaces_default_folder(read: Any) -> None:
    assert read("/here").program == Path("/here/application_source")
    assert read("/here", program="/there").program == Path("/there")


@pytest.mark.parametrize(
    ("package", "program", "text"),
    [
        ("/nowhere", "", "the program's folder: /nowhere/application_source does not exist"),
        ("/here", "/nowhere/it", "parameter ~program: /nowhere/it does not exist: give the absolute path"),
    ],
)
def test_missing_program_is_an_error_with_advice(read: Any, package: str, program: str, text: str) -> None:
    with pytest.raises(UsageError, match=text):
        read(package, program=program)


def test_program_file_is_an_error(tmp_path: Path) -> None:
    path = tmp_path / "rules.txt"
    path.write_text("")
    with pytest.raises(UsageError, match=r"rules.txt is not a folder: give"):
        read_parameters({"program": str(path)}, Path)


def test_numbers_and_flags_are_read(read: Any) -> None:
    parameters = read(
        queue=7, max_depth=5, max_seconds=2, max_inferences=1000, allow_goals=True, embedded=True
    )
    assert (parameters.queue, parameters.settings.queue, parameters.settings.max_depth) == (7, 7, 5)
    assert (parameters.settings.limits.seconds, parameters.settings.limits.inferences) == (2.0, 1000)
    assert parameters.settings.allow_goals
    assert not parameters.settings.allow_swi
    assert read(allow_swi=True).settings.allow_swi
    assert not parameters.settings.allow_flags
    assert read(allow_flags=True).settings.allow_flags
    assert parameters.embedded


def test_folders_for_goals_are_empty_by_default(read: Any) -> None:
    settings = read().settings
    assert (settings.folders, settings.write_folders) == ((), ())
    settings = read(folders=["/data", "/more"], write_folders=["/out"], max_file_megabytes=5).settings
    assert (settings.folders, settings.write_folders) == (("/data", "/more"), ("/out",))
    assert settings.max_file_megabytes == 5


@pytest.mark.parametrize(
    ("name", "value"),
    [
        ("program", 3),
        ("direct", "sometimes"),
        ("direct", ["tf"]),
        ("direct", [["tf", 1]]),
        ("embedded", "yes"),
        ("allow_goals", 1),
        ("queue", 0),
        ("queue", "many"),
        ("queue", 2.5),
        ("max_depth", -1),
        ("max_seconds", True),
        ("max_seconds", -1),
        ("max_seconds", float("nan")),
        ("watchdog", "soon"),
        ("max_megabytes", "0.5"),
        ("max_megabytes", float("inf")),
        ("max_output_megabytes", -1),
        ("max_inferences", 1.5),
        ("max_skew", float("inf")),
        ("diagnostics", 1e300),
        ("max_inferences", "x"),
        ("folders", "/data"),
        ("folders", [1]),
        ("write_folders", {"a": "/data"}),
        ("write_folders", "/data"),
        ("hardware_id", 7),
        ("max_file_megabytes", 0),
        ("max_file_megabytes", "x"),
    ],
)
def test_invalid_value_is_an_error(read: Any, name: str, value: Any) -> None:
    with pytest.raises(UsageError, match=name):
        read(**{name: value})


@pytest.mark.parametrize("value", [["scan", "sensor_msgs/LaserScan"], [["scan", "sensor_msgs/LaserScan"]]])
def test_list_of_direct_topics_is_read(read: Any, value: Any) -> None:
    assert read(direct=value).direct == (TopicType("scan", "sensor_msgs/LaserScan"),)


def test_unknown_parameter_is_warned_of(read: Any, caplog: pytest.LogCaptureFixture) -> None:
    read(max_second=1, queue=5, quick=True)
    warnings = [record.getMessage() for record in caplog.records]
    # Goals may read the other one.
    assert warnings == ["there is no parameter ~max_second; did you mean ~max_seconds?"]


def test_dashboard_is_disabled_by_default(read: Any) -> None:
    assert (read().dashboard, read().dashboard_queries) == (None, False)
    assert read(dashboard=True).dashboard == DASHBOARD_PORT
    assert read(dashboard=9000).dashboard == 9000
    assert read(dashboard_queries=True).dashboard_queries
    for value in (0, -1, 1 << 16, "yes", 80.5):
        with pytest.raises(
            UsageError, match="parameter ~dashboard: expected true, false or the number of a port"
        ):
            read(dashboard=value)


def test_nothing_is_forwarded_by_default(read: Any) -> None:
    assert read().forwarding is None
    # The launch file of ROS 1 passes empty defaults.
    assert read(forward_topics=[], forward_robot="", forward_queue="").forwarding is None


FORWARDING = {
    "forward": "mqtt://r07@fleet",
    "forward_robot": "r07",
    "forward_topics": ["alarm", "/arm/*"],
    "forward_queue": "/var/queue.db",
}


def test_options_of_forwarding(read: Any, tmp_path: Path) -> None:
    password = tmp_path / "password"
    password.write_text("secret\n")
    options = read(**FORWARDING, forward_password=str(password), forward_megabytes=5).forwarding
    assert options.broker == ("fleet", 1883, False, "r07", "secret", None)
    assert (options.robot, options.topics, options.queue) == (
        "r07",
        ("alarm", "/arm/*"),
        Path("/var/queue.db"),
    )
    assert (options.max_bytes, read(**FORWARDING).forwarding.max_bytes) == (5_000_000, 100_000_000)


@pytest.mark.parametrize(
    ("changes", "problem"),
    [
        ({"forward": ""}, "~forward_topics: nothing is forwarded without ~forward"),
        ({"forward": "fleet"}, "~forward: 'fleet' is not the address of a broker"),
        (
            {"forward_robot": "r/7"},
            "~forward_robot: expected the name of the robot, without spaces, .* found 'r/7'",
        ),
        ({"forward_robot": ""}, "~forward_robot: expected the name of the robot"),
        ({"forward_topics": []}, "~forward_topics: expected a list of topics"),
        (
            {"forward_topics": ["a b"]},
            "~forward_topics: expected names of topics, as alarm or /arm/., found 'a b'",
        ),
        (
            {"forward_topics": ["arm/*"]},
            "~forward_topics: expected names of topics, as alarm or /arm/., found 'arm/.'",
        ),
        ({"forward_queue": ""}, "~forward_queue: expected the path of a file"),
        ({"forward_password": "/nowhere/x"}, "~forward_password: /nowhere/x cannot be read"),
        (
            {"forward": "mqtts://fleet", "forward_password": "/nowhere/x"},
            "~forward_password: ~forward has no user: expected mqtt://USER@HOST",
        ),
        ({"forward_ca": "/nowhere/x"}, "~forward_ca: ~forward has no TLS: expected mqtts://HOST"),
        ({"forward_megabytes": 0}, "~forward_megabytes: expected a positive number"),
    ],
)
def test_wrong_options_of_forwarding_are_refused(read: Any, changes: Any, problem: str) -> None:
    with pytest.raises(UsageError, match=f"parameter {problem}"):
        read(**{**FORWARDING, **changes})


def test_adjusted_parameters_equal_those_of_start(read: Any) -> None:
    values = {
        "max_seconds": 2,
        "max_inferences": 1000,
        "max_megabytes": 0,
        "max_output_megabytes": 0.5,
        "watchdog": 0,
        "max_gap": 3,
        "watermark_delay": 0.5,
        "max_watermark_delay": 2,
        "max_skew": 9,
        "diagnostics": 0,
        "hardware_id": "robot7",
    }
    assert set(values) == set(PARAMETER_DESCRIPTIONS) - set(FIXED_PARAMETERS)
    started = read(queue=7, **values)
    assert started != read(queue=7)
    assert read(queue=7).adjust(read_adjustable_parameters(values)) == started
    assert started.adjust(read_adjustable_parameters({})) == read(queue=7)


@pytest.mark.parametrize("name", ["max_seconds", "watermark_delay", "diagnostics", "max_skew"])
def test_invalid_adjusted_value_is_an_error(name: str) -> None:
    with pytest.raises(UsageError, match=f"parameter ~{name} .*: expected a number from 0 to .*, found -1"):
        read_adjustable_parameters({name: -1})


@pytest.mark.parametrize("name", FIXED_PARAMETERS)
def test_fixed_parameter_cannot_be_changed(name: str) -> None:
    with pytest.raises(UsageError, match=f"parameter ~{name}: it cannot be changed, because "):
        check_adjustable(name)


def test_unknown_parameter_cannot_be_changed() -> None:
    check_adjustable("max_seconds")
    with pytest.raises(UsageError, match="there is no parameter ~max_second; did you mean ~max_seconds?"):
        check_adjustable("max_second")


def test_descriptions_and_reference_have_same_parameters() -> None:
    page = (Path(__file__).parents[2] / "docs" / "reference" / "nodes.md").read_text(encoding="utf-8")
    assert set(re.findall(r"^\| `~(\w+)` \|", page, re.MULTILINE)) == set(PARAMETER_DESCRIPTIONS)


def test_reference_lists_adjustable_and_fixed_parameters() -> None:
    page = (Path(__file__).parents[2] / "docs" / "reference" / "ros2-node.md").read_text(encoding="utf-8")
    adjustable, fixed = (
        {
            name
            for row in re.findall(r"^\| (`.*?) \|", table, re.MULTILINE)
            for name in re.findall(r"`(\w+)`", row)
        }
        for table in re.findall(r"\| (?:can be changed|read-only) \|.*\n((?:\|.*\n)+)", page)
    )
    assert fixed - {"autostart", "use_sim_time"} == set(FIXED_PARAMETERS)
    assert adjustable == set(PARAMETER_DESCRIPTIONS) - set(FIXED_PARAMETERS)
