"""A few random texts; ``fuzz.py`` beside this file makes as many as one likes."""

import importlib.util
from pathlib import Path


def test_nothing_but_terms_and_faults():
    spec = importlib.util.spec_from_file_location("fuzz", str(Path(__file__).with_name("fuzz.py")))
    fuzz = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(fuzz)
    reader = fuzz.run(1500, 7)
    assert reader.read > 500
    assert reader.faults > 1000
