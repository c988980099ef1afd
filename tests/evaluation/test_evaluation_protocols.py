import numpy as np
import pytest

import kt3dmoseg
from kt3dmoseg.errors import UnknownNameError
from kt3dmoseg.io import dataset_paths
from mseg.evaluation import clip_checksum, list_protocols, load_protocol
from mseg.evaluation.protocol import choose_protocol


def test_the_five_benchmarks():
    assert list_protocols() == ["hopkins12", "hopkins155", "kt3dmoseg", "mtpv62", "synth"]
    sizes = {name: load_protocol(name).n_clips for name in list_protocols()}
    assert sizes == {"hopkins12": 12, "hopkins155": 155, "kt3dmoseg": 22, "mtpv62": 62, "synth": 200}


@pytest.mark.parametrize("name", list_protocols())
def test_benchmark_is_consistent(name):
    protocol = load_protocol(name)
    groups = {g.name: g for g in protocol.groups}
    assert groups["all"].n_clips == protocol.n_clips
    for group in protocol.groups:
        assert not group.clips or len(set(group.clips)) == group.n_clips
    for parts in protocol.published.values():
        assert set(parts) <= set(groups)
        assert all(0 <= v <= 100 for values in parts.values() for v in values.values())
    assert protocol.source
    assert name == "synth" or "Subset" in protocol.published


def test_misspelt_benchmark():
    with pytest.raises(UnknownNameError, match="hopkins155"):
        load_protocol("hopkins156")


def test_hopkins155_counts_two_and_three_motions_and_never_dancing():
    protocol = load_protocol("hopkins155")
    motions = {"cars1": 2, "1R2RC": 3, "1R2RC_g12": 2, "dancing": 5}
    found = {g.name: protocol.clips_of(g, motions) for g in protocol.groups}
    assert found == {
        "two": ["cars1", "1R2RC_g12"],
        "three": ["1R2RC"],
        "all": ["cars1", "1R2RC", "1R2RC_g12"],
    }
    assert protocol.coverage(motions) == "3 of 155 clips"


def test_mtpv62_parts():
    protocol = load_protocol("mtpv62")
    motions = {"MTPV_data_Boat": 2, "Hopkins50_cars1": 2, "1R2RC": 3, "1R2RC_g12": 2, "dancing": 5}
    found = {g.name: protocol.clips_of(g, motions) for g in protocol.groups}
    assert found["missing"] == ["MTPV_data_Boat"]
    assert found["hopkins"] == ["Hopkins50_cars1", "1R2RC"]
    assert found["perspective"] == []
    assert found["all"] == ["MTPV_data_Boat", "Hopkins50_cars1", "1R2RC"]


def test_a_complete_benchmark_is_called_complete():
    protocol = load_protocol("hopkins12")
    assert protocol.coverage(protocol.clips) == "all 12 clips"
    assert protocol.coverage(protocol.clips[:8]) == "8 of 12 clips"


@pytest.mark.data
@pytest.mark.parametrize(
    ("folder", "name", "coverage", "groups"),
    [
        ("kt3dmoseg/release", "kt3dmoseg", "14 of 22 clips", {"all": 14}),
        ("hopkins155", "hopkins155", "99 of 155 clips", {"two": 77, "three": 22, "all": 99}),
        ("hopkins12", "hopkins12", "8 of 12 clips", {"all": 8}),
        ("mtpv62", "mtpv62", "7 of 62 clips", {"perspective": 0, "missing": 7, "hopkins": 0, "all": 7}),
    ],
)
def test_real_data_fall_into_their_groups(data_root, folder, name, coverage, groups):
    paths = dataset_paths(data_root / folder)
    protocol = load_protocol(name)
    assert choose_protocol("", paths) == protocol
    motions = {n: kt3dmoseg.load(p).n_motions if name == "hopkins155" else 2 for n, p in paths.items()}
    assert protocol.coverage(motions) == coverage
    assert {g.name: len(protocol.clips_of(g, motions)) for g in protocol.groups} == groups


@pytest.mark.data
def test_prevalence_and_checksums_are_those_of_the_data(data_root):
    protocol = load_protocol("kt3dmoseg")
    clips = kt3dmoseg.load_dataset(data_root / "kt3dmoseg" / "release")
    for name, clip in clips.items():
        share = np.bincount(clip.labels.label).max() / len(clip.labels)
        assert protocol.prevalence[name] == pytest.approx(100 * (1 - share), abs=0.005)
    prints = {name: clip_checksum(clip) for name, clip in clips.items()}
    assert protocol.version_of(prints) == "2018"
    assert protocol.version_of({**prints, "Seq005_Clip01": "0" * 16}) == ""


def test_clips_of_another_benchmark_do_not_count():
    hopkins, mtpv = load_protocol("hopkins155"), load_protocol("mtpv62")
    for name in ("MTPV_data_Boat", "oc1R2RC", "Seq005_Clip01", "Cars1", "mine"):
        assert not hopkins.holds(name)
        assert mtpv.holds(name) == name.startswith("MTPV")
    assert choose_protocol("", ["MTPV_data_Boat", "cars1", "1R2RC"]).name == "mtpv62"
    assert choose_protocol("", ["cars1", "1R2RC", "1R2RC_g12"]).name == "hopkins155"
    assert mtpv.of_version("any").published == mtpv.published
    assert not load_protocol("kt3dmoseg").of_version("mine").published
