"""One small scene for all tests of this folder."""

from functools import cache

import pytest

from kt3dmoseg.synthetic import Scene, SceneOptions, make_scene


@pytest.fixture(scope="session")
def scene() -> Scene:
    scene = make_scene(SceneOptions(width=310, height=94, frames=8, objects=4, seed=3))
    scene.frame = cache(scene.frame)  # each is rendered once
    return scene
