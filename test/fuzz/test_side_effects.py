"""Detection of acts that an input must not perform; documented acts are allowed."""

import signal
from pathlib import Path
from typing import Dict, Tuple

import pytest

from fuzz import campaign as campaign_module
from fuzz.campaign import Campaign
from fuzz.kinds.planted_findings import ACTS
from fuzz.known_findings import reason
from fuzz.side_effects import Watch


@pytest.fixture(scope="module")
def findings() -> Dict[str, Tuple[str, str]]:
    """The findings by the acts of ``kinds/planted_findings.py``."""
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(campaign_module, "MAX_INPUT_CPU_SECONDS", 1.5)
        campaign = Campaign("planted_findings")
        campaign.run(len(ACTS))
    acts = list(ACTS)
    return {acts[line["number"]]: (line["category"], line["detail"]) for line in campaign.findings.values()}


@pytest.mark.slow
@pytest.mark.parametrize("act", ["documented", "scratch"])
def test_allowed_act_is_no_finding(findings: Dict[str, Tuple[str, str]], act: str) -> None:
    assert act not in findings


EXPECTED = {
    "undocumented": ("exception", "KeyError: 'wrong'"),
    "recursion": ("exception", "RecursionError"),
    "swallowed": ("action", "os.system (b'true'"),
    "loop": ("time", ""),
    "grow": ("growth", ""),
    "read": ("action", "open ('/etc/passwd'"),
    "write": ("action", "open ('written'"),
    "listing": ("action", "os.listdir"),
    "removal": ("action", "os.remove"),
    "folder": ("action", "os.mkdir"),
    "temporary": ("action", "open ("),
    "process": ("action", "subprocess.Popen"),
    "fork": ("action", "os.fork"),
    "replaced": ("action", "os.exec"),
    "connection": ("action", "socket.__new__"),
    "source": ("action", "compile"),
    "code": ("action", "compile"),
    "module": ("action", "import ('colorsys'"),
    "trace": ("action", "sys.settrace"),
}


@pytest.mark.slow
@pytest.mark.parametrize("act", EXPECTED)
def test_forbidden_act_is_a_finding(findings: Dict[str, Tuple[str, str]], act: str) -> None:
    category, detail = EXPECTED[act]
    assert findings[act][0] == category
    assert findings[act][1].startswith(detail)


@pytest.mark.slow
@pytest.mark.parametrize(
    ("act", "category", "frame"),
    [("crash", "died (-6)", "planted_findings.py"), ("endless", "hang", "in endless")],
)
def test_crash_or_uninterruptible_step_is_a_finding(
    findings: Dict[str, Tuple[str, str]], act: str, category: str, frame: str
) -> None:
    assert findings[act][0] == category
    assert frame in findings[act][1]


def test_input_file_is_replayed(tmp_path: Path) -> None:
    path = tmp_path / "input"
    path.write_text("swallowed")
    campaign = Campaign("planted_findings")
    campaign.file(path)
    ((line),) = campaign.counted
    assert (line["category"], bytes.fromhex(line["input"])) == ("action", b"swallowed")


@pytest.mark.slow
def test_number_determines_input() -> None:
    first, second = Campaign("program_texts", 3), Campaign("program_texts", 3)
    first.run(200, 1)
    second.run(200, 2)
    assert (first.done, first.accepted_count, first.refused_count) == (
        second.done,
        second.accepted_count,
        second.refused_count,
    )


@pytest.mark.parametrize(
    ("kind", "category", "place"),
    [
        ("limits", "time", "ord_union/3 2.1 s"),
        ("limits", "exception", "ord_union/3 KeyError"),
        ("joins", "growth", "unrestricted 60 MB"),
        ("joins", "time", "other policies 5.0 s"),
        ("states", "action", "open"),
    ],
)
def test_other_findings_are_not_known(kind: str, category: str, place: str) -> None:
    assert not reason(kind, category, place)


def test_signal_handler_and_timer_are_restored(tmp_path: Path) -> None:
    handler, timer = signal.getsignal(signal.SIGPROF), signal.getitimer(signal.ITIMER_PROF)
    with Watch(tmp_path).installed():
        assert signal.getitimer(signal.ITIMER_PROF) != timer
    assert signal.getsignal(signal.SIGPROF) == handler
    assert signal.getitimer(signal.ITIMER_PROF) == timer
