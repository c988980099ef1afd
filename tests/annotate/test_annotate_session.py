"""Editing: undo after do is identity; saving never overwrites what somebody else saved."""

from __future__ import annotations

import multiprocessing
import pickle
from dataclasses import replace

import pytest
from annotation_scenes import FRAMES, SIZE, box, scene
from hypothesis import settings
from hypothesis import strategies as st
from hypothesis.stateful import RuleBasedStateMachine, initialize, invariant, rule

from kt3dmoseg.annotate import AnnotationSession, load_annotation
from kt3dmoseg.annotate.session import StaleRevisionError, save_revision
from kt3dmoseg.errors import InvalidValueError


class Editing(RuleBasedStateMachine):
    """Random edits and undos, against a plain list of states."""

    @initialize()
    def start(self):
        self.session = AnnotationSession.new("scene", image_size=SIZE, n_frames=FRAMES)
        self.states = [self.session.annotation]

    def did(self):
        if self.session.annotation != self.states[-1]:
            self.states.append(self.session.annotation)

    def pick(self, data):
        items = self.session.annotation.objects
        return data.draw(st.sampled_from(items)).id if items else None

    @rule(motion=st.one_of(st.integers(0, 4), st.just("reject")), frame=st.integers(0, FRAMES - 1))
    def add(self, motion, frame):
        self.session.add_object("thing", frame, [box(3, 4)], motion=motion)
        self.did()

    @rule(
        data=st.data(),
        frame=st.integers(0, FRAMES - 1),
        visibility=st.sampled_from(["visible", "occluded", "outside"]),
    )
    def draw(self, data, frame, visibility):
        if chosen := self.pick(data):
            polygons = [] if visibility == "outside" else [box(frame, 5)]
            self.session.set_key_frame(chosen, frame, polygons, visibility)
            self.did()

    @rule(data=st.data(), name=st.text(min_size=1, max_size=5).filter(str.strip))
    def rename(self, data, name):
        if chosen := self.pick(data):
            now = self.session.annotation
            objects = tuple(replace(o, name=name) if o.id == chosen else o for o in now.objects)
            self.session.replace(replace(now, objects=objects))
            self.did()

    @rule(data=st.data())
    def remove(self, data):
        if chosen := self.pick(data):
            now = self.session.annotation
            kept = tuple(o for o in now.objects if o.id != chosen)
            self.session.replace(replace(now, objects=kept))
            self.did()

    @rule(frame=st.integers(0, FRAMES - 1))
    def mark(self, frame):
        self.session.add_mark(frame, box(0, 0), motion=2)
        self.did()

    @rule()
    def undo(self):
        assert self.session.undo() == (len(self.states) > 1)
        self.states = self.states[:-1] or self.states

    @invariant()
    def is_where_it_should_be(self):
        assert self.session.annotation == self.states[-1]


Editing.TestCase.settings = settings(max_examples=25, stateful_step_count=25, deadline=None)
TestEditing = Editing.TestCase


def test_a_refused_edit_changes_nothing():
    session = AnnotationSession(scene())
    for attempt in (
        lambda: session.set_key_frame(1, FRAMES, [box(0, 0)]),
        lambda: session.set_key_frame(1, 0, [[(0, 0), (1, 1)]]),
        lambda: session.set_key_frame(99, 0, [box(0, 0)]),
        lambda: session.add_object("thing", 0, [box(0, 0)], motion=1, kind="spaceship"),
        lambda: session.add_object(" ", 0, [box(0, 0)], motion=1),
        lambda: session.add_mark(FRAMES, box(0, 0), motion=1),
        lambda: session.add_mark(0, box(0, 0), motion=-1),
    ):
        with pytest.raises(InvalidValueError):
            attempt()
    assert session.annotation == scene()
    assert not session.undo()


def test_saving_counts_revisions_and_undo_does_not(tmp_path):
    path = tmp_path / "scene.json"
    session = AnnotationSession.new("scene", image_size=SIZE, n_frames=FRAMES)
    session.add_object("thing", 0, [box(1, 1)], motion=1)
    assert session.save(path) == 1
    session.undo()
    assert session.save(path) == 2
    assert load_annotation(path).objects == ()
    assert load_annotation(path).revision == 2


def test_a_stale_session_does_not_overwrite(tmp_path):
    path = tmp_path / "scene.json"
    first = AnnotationSession.new("scene", image_size=SIZE, n_frames=FRAMES)
    second = AnnotationSession.new("scene", image_size=SIZE, n_frames=FRAMES)
    first.save(path)
    second.add_object("thing", 0, [box(1, 1)], motion=1)
    with pytest.raises(StaleRevisionError, match="revision 1"):
        second.save(path)
    assert load_annotation(path) == first.annotation
    with pytest.raises(StaleRevisionError) as caught:
        save_revision(path, AnnotationSession.new("scene", image_size=SIZE, n_frames=FRAMES).annotation)
    assert caught.value.current == first.annotation
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
    start = save_revision(path, AnnotationSession.new("scene", image_size=SIZE, n_frames=FRAMES).annotation)
    workers = [context.Process(target=_save, args=(path, start, results)) for _ in range(6)]
    for worker in workers:
        worker.start()
    answers = [results.get(timeout=60) for _ in workers]
    for worker in workers:
        worker.join()
    assert sorted(answers, key=str) == [2, *[None] * 5]
