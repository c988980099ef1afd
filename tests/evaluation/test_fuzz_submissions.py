import io
import zipfile

import numpy as np
import submission_fuzz


def test_a_sample_of_mutated_submissions(tmp_path):
    """The full run is ``python tests/evaluation/submission_fuzz.py 10000``."""
    found = {}
    for seed in range(100):
        outcome = submission_fuzz.run_case(seed, tmp_path)
        found[outcome] = found.get(outcome, 0) + 1
    assert found["valid"] > 5  # unmutated ones among them: the fuzzer is not stuck at the door
    assert found["invalid"] > 60


def test_unmutated_are_valid(tmp_path):
    files = submission_fuzz.base_files("npz", 2)
    packed = tmp_path / "s.zip"
    with zipfile.ZipFile(packed, "w") as archive:
        for name, content in files.items():
            archive.writestr(name, content)
    assert submission_fuzz.validate_submission(packed, submission_fuzz.CLIPS).ok
    arrays = np.load(io.BytesIO(files["seed-1/example_two.npz"]))
    assert sorted(arrays.files) == ["label", "track"]
