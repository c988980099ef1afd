"""Commands that work on KITTI's drives and on what is published."""

from pathlib import Path
from typing import Annotated, Any

from cyclopts import Parameter

from kt3dmoseg.app import Catalogs, File, Folder, Url, flags, group
from kt3dmoseg.errors import FileFormatError
from kt3dmoseg.kitti import LocateOptions, PullOptions
from kt3dmoseg.text import text_table

Clips = Annotated[str, Parameter(help="Names (default: all of --catalog, else the 22).")]
Root = Annotated[Folder, Parameter(alias=("-o", "--root"))]


@flags(PullOptions)
def pull(
    *clips: Clips,
    output: Annotated[Root, Parameter(help="KITTI raw root to fill.")] = Path("kitti_raw"),
    catalogs: Catalogs = (),
    **options: Any,  # noqa: ANN401
) -> None:
    """Fetch the clips' frames from KITTI raw, and nothing else.

    Only the needed files of KITTI's zips are read: frames, their timestamps and GPS/IMU packets, the
    calibration, and tracklets where there are any. Run it again after an interruption: it continues, and
    fetches nothing twice. A second run that finds everything in place makes no request.
    """
    from kt3dmoseg.kitti import pull

    pull(output, clips, catalogs=catalogs, **options)


@flags(LocateOptions)
def locate(
    *clips: Clips,
    output: Annotated[Root, Parameter(help="Folder of located.toml.")] = Path("kitti_raw"),
    catalogs: Catalogs = (),
    **options: Any,  # noqa: ANN401
) -> None:
    """Find the frame numbers of clips in their KITTI drives.

    The directory of a drive's zip has CRC32 and size of every frame; that is enough when the clip's frames
    are KITTI's own files, and costs a few hundred kB. Otherwise the drive's frames are read and compared by
    pixels; and, when the clip's own frames are given, by correlation. What is proved goes to located.toml in
    the output folder, where `kt3dmoseg pull` and `kt3dmoseg build` find it.
    """
    from kt3dmoseg.kitti import locate

    locate(output, clips, catalogs=catalogs, **options)


def fetch_release(
    *names: Annotated[str, Parameter(help="Names: kt3dmoseg (default), hopkins155, hopkins12, mtpv62.")],
    output: Annotated[Root, Parameter(help="Folder to fill.")] = Path("data"),
    mirror: Annotated[
        Url | None, Parameter(help="Address of a folder with the same files, one sub-folder per name.")
    ] = None,
) -> None:
    """Fetch the 2018 release of KT3DMoSeg, and the other benchmarks, from their public homes.

    Prints for each where it comes from, its licence, and what to do by hand when the page is gone.
    """
    from kt3dmoseg.kitti import fetch_release

    fetch_release(output, names or ("kt3dmoseg",), mirror=mirror)


catalog = group("catalog", "List the clips, check catalogs, add clips of your own.")


@catalog.command(name="list")
def list_clips(*, catalogs: Catalogs = ()) -> None:
    """Print the clips."""
    from kt3dmoseg.catalog import format_numbers, load

    rows = []
    for clip in load(*catalogs).values():
        size = "x".join(map(str, clip.size)) if clip.size else "unknown"
        numbers = format_numbers(clip.numbers) if clip.numbers else "to be located"
        rows.append([clip.name, clip.drive.name, f"{clip.camera}", f"{clip.length}", size, numbers])
    print(text_table(rows, ["clip", "drive", "camera", "frames", "size", "numbers"]))


@catalog.command
def check(*catalogs: Annotated[Path, Parameter(help="Files (default: the built-in one).")]) -> None:
    """Print every problem of catalogs."""
    from kt3dmoseg.catalog import BUILT_IN, parse_all

    wrong = 0
    for path, clips, problems in parse_all(catalogs or [BUILT_IN]):
        for problem in problems:
            print(f"{path}: {problem}")
        wrong += len(problems)
        print(f"{path}: {len(clips)} clips, {len(problems)} problems")
    if wrong:
        raise FileFormatError("catalog check", found=f"{wrong} problems")


@catalog.command
def add(
    name: Annotated[str, Parameter(help="Name of the clip.")],
    /,
    frames: Annotated[
        Folder | None, Parameter(help="Folder with the clip's PNG files, to locate them by.")
    ] = None,
    *,
    catalog: Annotated[File, Parameter(help="The file to add to; made when missing.")],
    date: Annotated[str, Parameter(help="Day of the drive, 2011_09_26.")],
    drive: Annotated[str, Parameter(help="Number of the drive.")],
    camera: Annotated[str, Parameter(help="0 gray left, 1 gray right, 2 colour left, 3 colour right.")] = "0",
    numbers: Annotated[str | None, Parameter(help="Frame numbers, 40-59 or 40-59,80.")] = None,
) -> None:
    """Add a clip to a catalog of your own.

    kt3dmoseg catalog add MyClip --date 2011_09_26 --drive 5 --camera 2 --numbers 40-59 --catalog mine.toml
    kt3dmoseg catalog add MyClip FRAMES --date 2011_09_26 --drive 5 --catalog mine.toml
    """
    from kt3dmoseg.catalog import Drive, Entry, add, parse_numbers
    from kt3dmoseg.kitti.raw import fingerprint_folder

    marks, size = fingerprint_folder(frames) if frames else ((), None)
    chosen = None if numbers is None else parse_numbers(numbers)
    place = Drive(date, drive), camera  # type: ignore[arg-type]  # digits, too
    entry = Entry(name, *place, len(chosen or marks), size, chosen, marks)  # type: ignore[arg-type]
    add(catalog, entry)
    print(f"{catalog}: added {entry.name}, {entry.length} frames of {entry.drive.name}")
