"""Saving never overwrites what somebody else saved."""

from __future__ import annotations

import multiprocessing
import pickle
from dataclasses import replace

import pytest
from annotation_scenes import FRAMES, SIZE, scene

from kt3dmoseg.annotate import Annotation, load_annotation, save_revision
from kt3dmoseg.annotate.model import StaleRevisionError

EMPTY = Annotation("scene", SIZE, FRAMES)


def test_saving_counts_revisions(tmp_path):
    path = tmp_path / "scene.json"
    first = save_revision(path, replace(scene(), revision=0))
    assert first.revision == 1
    assert save_revision(path, replace(first, objects=())).revision == 2
    assert load_annotation(path).objects == ()
    assert load_annotation(path).revision == 2


def test_a_stale_annotation_does_not_overwrite(tmp_path):
    path = tmp_path / "scene.json"
    first = save_revision(path, EMPTY)
    with pytest.raises(StaleRevisionError, match="revision 1") as caught:
        save_revision(path, scene())
    assert load_annotation(path) == first
    assert caught.value.current == first
    assert str(pickle.loads(pickle.dumps(caught.value))) == str(caught.value)


def _save(path, annotation, results):
    try:
        results.put(save_revision(path, annotation).revision)
    except StaleRevisionError:
        results.put(None)


def test_of_many_processes_exactly_one_saves_a_revision(tmp_path):
    context = multiprocessing.get_context("fork")
    results = context.Queue()
    path = tmp_path / "scene.json"
    start = save_revision(path, EMPTY)
    workers = [context.Process(target=_save, args=(path, start, results)) for _ in range(6)]
    for worker in workers:
        worker.start()
    answers = [results.get(timeout=60) for _ in workers]
    for worker in workers:
        worker.join()
    assert sorted(answers, key=str) == [2, *[None] * 5]
