"""Write what makes the drives of the synthetic benchmark hard into mseg/protocols/synth.toml.

Usage: python tools/make_synth_protocol.py   (two minutes)
"""

from __future__ import annotations

from pathlib import Path

from kt3dmoseg.synthetic import make_drive, measure_drive, plan_drives

PROTOCOL = Path(__file__).parents[1] / "mseg" / "protocols" / "synth.toml"
HEADING = "[attributes]\n"


def main() -> None:
    lines = []
    for plan in plan_drives():
        facts = [f"{name} = {value:.4g}" for name, value in measure_drive(make_drive(plan)).items()]
        lines.append(f'{plan.name} = {{ camera = "{plan.camera}", {", ".join(facts)} }}\n')
    head = PROTOCOL.read_text(encoding="utf-8").partition(HEADING)[0]
    PROTOCOL.write_text(head + HEADING + "".join(lines), encoding="utf-8")


if __name__ == "__main__":
    main()
