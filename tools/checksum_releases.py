"""Make kt3dmoseg/kitti/release_checksums.toml: SHA-256 of the benchmarks' files that are on this machine.

Usage: python tools/checksum_releases.py DATA [-o FILE], where DATA is laid out as fetch-release does.
"""

from __future__ import annotations

import argparse
from pathlib import Path

from kt3dmoseg.files import sha256_file, write_text
from kt3dmoseg.kitti import releases

OUTPUT = Path(releases.__file__).with_name("release_checksums.toml")
HEAD = "# SHA-256 of the published benchmarks' files. Written by tools/checksum_releases.py.\n"


def main() -> int:
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("data", type=Path)
    parser.add_argument("-o", "--output", type=Path, default=OUTPUT)
    arguments = parser.parse_args()
    text = HEAD
    for name, release in releases.releases().items():
        folder = arguments.data / release.folder
        rows = [
            f'"{path.relative_to(folder).as_posix()}" = "{sha256_file(path)}"'
            for path in sorted(folder.rglob("*.mat"))
        ]
        text += "\n".join([f"\n[{name}]", *rows]) + "\n"
        print(f"{name}: {len(rows)} files")
    write_text(arguments.output, text)
    return 0


if __name__ == "__main__":
    raise SystemExit(main())
