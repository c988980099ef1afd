"""One small scene for all tests of this folder."""

import pytest

from kt3dmoseg.synthetic import Scene, SceneOptions, make_scene


@pytest.fixture(scope="session")
def scene() -> Scene:
    return make_scene(SceneOptions(width=310, height=94, frames=8, objects=4, seed=3))
