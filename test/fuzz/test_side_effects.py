"""That the watch sees what an input must not do, and lets it do what it may."""

import pytest

from fuzz import campaign as module
from fuzz.campaign import Campaign
from fuzz.kinds.forbidden_acts import ACTS
from fuzz.known_findings import reason


@pytest.fixture(scope="module")
def found():
    """What was found, by the inputs of ``kinds/forbidden_acts.py``."""
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(module, "MAX_INPUT_CPU_SECONDS", 1.5)
        campaign = Campaign("forbidden_acts")
        campaign.run(len(ACTS))
    acts = list(ACTS)
    return {acts[line["number"]]: (line["what"], line["detail"]) for line in campaign.findings.values()}


@pytest.mark.slow
@pytest.mark.parametrize("act", ["documented", "scratch"])
def test_what_is_allowed(found, act):
    assert act not in found


FOUND = {
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
@pytest.mark.parametrize("act", FOUND)
def test_what_counts(found, act):
    what, detail = FOUND[act]
    assert found[act][0] == what
    assert found[act][1].startswith(detail)


@pytest.mark.slow
def test_a_process_that_dies_of_its_input(found):
    what, detail = found["crash"]
    assert what == "died (-6)"
    assert "forbidden_acts.py" in detail


@pytest.mark.slow
def test_a_step_that_no_handler_can_end(found):
    what, detail = found["endless"]
    assert what == "hang"
    assert "in endless" in detail


def test_a_file_is_replayed(tmp_path):
    path = tmp_path / "input"
    path.write_text("swallowed")
    campaign = Campaign("forbidden_acts")
    campaign.file(path)
    ((line),) = campaign.counted
    assert (line["what"], bytes.fromhex(line["input"])) == ("action", b"swallowed")


@pytest.mark.slow
def test_the_same_number_makes_the_same_input():
    one, two = Campaign("texts", 3), Campaign("texts", 3)
    one.run(200, 1)
    two.run(200, 2)
    assert (one.done, one.accepted_count, one.refused_count) == (
        two.done,
        two.accepted_count,
        two.refused_count,
    )


@pytest.mark.parametrize(
    ("kind", "what", "place", "known"),
    [
        ("limits", "time", "ord_union/3 2.1 s", False),
        ("limits", "exception", "ord_union/3 KeyError", False),
        ("joins", "growth", "unrestricted 60 MB", False),
        ("joins", "time", "other policies 5.0 s", False),
        ("states", "action", "open", False),
    ],
)
def test_known_findings_are_told_from_others(kind, what, place, known):
    assert bool(reason(kind, what, place)) == known
