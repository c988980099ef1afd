"""tools/benchmark_agreement.py compares the rankings of two benchmarks."""

import json
import runpy
from pathlib import Path

TOOL = Path(__file__).parents[2] / "tools" / "benchmark_agreement.py"


def saved(path, errors):
    methods = [{"method": name} for name in errors]
    path.write_text(
        json.dumps({"methods": methods, "errors": [[[e] for e in row] for row in errors.values()]})
    )
    return str(path)


def test_rankings_and_significant_differences(tmp_path, capsys):
    main = runpy.run_path(str(TOOL))["main"]
    first = saved(tmp_path / "a.json", {"x": [0.1, 0.2, 0.3], "y": [0.2, 0.3, 0.4], "z": [0.5, 0.5, 0.5]})
    same = saved(tmp_path / "b.json", {"z": [0.9, 0.8], "y": [0.2, 0.2], "x": [0.0, 0.1]})
    reverse = saved(tmp_path / "c.json", {"x": [0.9, 0.9], "y": [0.5, 0.4], "z": [0.0, 0.1]})
    main(first, same, reverse)
    text = capsys.readouterr().out
    assert [line.split()[2] for line in text.splitlines() if "Kendall" in line] == ["+1.00", "-1.00"]
    assert "x - y" in text
    assert "-10.00   0.00" in text
