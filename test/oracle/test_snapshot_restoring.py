"""Random programs that are restored between events; the command compares any number of them."""

import pytest

from retalis import RetalisError

from .snapshot_restoring import clock_difference, cut_case, cut_difference


@pytest.mark.slow
@pytest.mark.parametrize(
    ("revision", "streams", "first", "number"),
    [(False, False, 0, 15), (True, False, 50_000, 8), (False, True, 70_000, 8), (True, True, 80_000, 4)],
)
def test_restored_program_has_equal_outputs(revision: bool, streams: bool, first: int, number: int) -> None:
    restored_count = 0
    for seed in range(first, first + number):
        case, places = cut_case(seed, 4, revision, seed % 3 == 0, streams)
        assert cut_difference(case, places) is None, (seed, places, case.text())
        restored_count += bool(places)
    assert restored_count == number


@pytest.mark.slow
def test_restored_clock_programs_give_equal_outputs() -> None:
    refused = 0
    for seed in range(40):
        try:
            assert clock_difference(seed) is None, (
                f"python -m oracle.snapshot_restoring --clock --seed {seed}"
            )
        except RetalisError:
            refused += 1
    assert refused < 4
